"""What the reports of commands and of this package have in common."""

from typing import Any

import msgspec

from kontur_av.clock import NS_PER_S
from kontur_av.meters import Histogram, RateMeter


class Report(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """What all parts of a report have in common."""


class Latency(Report, frozen=True, kw_only=True):
    """Percentiles of a latency by nearest rank in a histogram."""

    p50: float
    p95: float
    p99: float
    max: float


class PayloadRates(Report, frozen=True, kw_only=True):
    """The rates of a stream's RTP payload."""

    payload_bps_mean: int
    #: The largest rate over a sliding second.
    payload_bps_max_1s: int
    #: The largest rate over a sliding tenth of a second.
    payload_bps_max_100ms: int


def rates(meter: RateMeter, mean_bps: float | None = None) -> dict[str, Any]:
    """The fields of `PayloadRates`. mean_bps: None: over the time from the first packet on."""
    return {
        "payload_bps_mean": round(meter.mean_bps() if mean_bps is None else mean_bps),
        "payload_bps_max_1s": round(meter.max_bps(NS_PER_S)),
        "payload_bps_max_100ms": round(meter.max_bps(NS_PER_S // 10)),
    }


def latency_ms(histogram: Histogram) -> Latency:
    """The latencies of a histogram of values in ns, in ms."""
    return Latency(**histogram.summary_ms())
