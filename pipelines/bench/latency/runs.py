"""The session of `bench latency` on virtual time, and the clocks of both its sessions."""

import time
from dataclasses import dataclass
from itertools import pairwise

from kontur_av.clock import NS_PER_MS, NS_PER_S, NS_PER_US
from pipelines.report.result import JsonReader, as_json
from pipelines.session.setup.table import Setup
from pipelines.virtual.simulate import simulate

_READINGS = 2000


@dataclass(frozen=True, slots=True)
class ClockMethod:
    """How instants were compared.

    method: in words. error_us: the largest error of a difference of two instants.
    """

    method: str
    error_us: float


VIRTUAL_CLOCK = ClockMethod("one virtual clock for all", 0.0)


def virtual_run(setup: Setup, *, seconds: float, seed: int) -> JsonReader:
    """The report of a session on virtual time."""
    return JsonReader(as_json(simulate(setup, seconds=seconds, seed=seed)))


def live_clock(report: JsonReader) -> ClockMethod:
    """The clock of a live session, and the largest error of a difference of two readings.

    The error is the time that a reading takes (p99) or the clock's resolution, whichever is
    longer. For media, add the error of the capture time that RTCP carried.
    """
    readings = [time.monotonic_ns() for _ in range(_READINGS)]
    steps = sorted(after - before for before, after in pairwise(readings))
    resolution_ns = time.get_clock_info("monotonic").resolution * NS_PER_S
    reading_us = max(resolution_ns, steps[len(steps) * 99 // 100]) / NS_PER_US
    stamps = [of.number("capture_stamp_error_us") for _, of in report.items("streams")]
    error_us = reading_us + max(stamps, default=0.0)
    return ClockMethod("CLOCK_MONOTONIC, one for all processes of the host", round(error_us, 2))


def radio_delay_ms(report: JsonReader) -> tuple[float, float]:
    """The least and the largest delay of the radio, ground to space."""
    if not report.has("gateways", "ground", "radio"):
        return 0.0, 0.0
    radio = report.at("gateways", "ground", "radio")
    return radio.number("delay_min_ns") / NS_PER_MS, radio.number("delay_max_ns") / NS_PER_MS
