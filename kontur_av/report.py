"""What the reports of commands and of this package have in common."""

import msgspec

from kontur_av.meters import Histogram


class Report(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """What all parts of a report have in common."""


class Latency(Report, frozen=True, kw_only=True):
    """Percentiles of a latency by nearest rank in a histogram."""

    p50: float
    p95: float
    p99: float
    max: float


def latency_ms(histogram: Histogram) -> Latency:
    """The latencies of a histogram of values in ns, in ms."""
    return Latency(**histogram.summary_ms())
