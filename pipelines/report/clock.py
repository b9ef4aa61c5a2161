"""What people read of the clocks of two machines."""

from collections.abc import Iterator

from kontur_av.clock import NS_PER_MS, NS_PER_S
from pipelines.report.collector import Collector
from pipelines.session.topology import Segment
from telepresence.link.figures import ClockFigures


def clock_words(peer: str, clock: ClockFigures) -> str:
    """One line: where the clock of `peer`, a segment, is, with the error."""
    if clock.offset_ns is None or clock.error_ns is None:
        return f"clock: {peer}'s is not known"
    error_ms = clock.error_ns / NS_PER_MS
    words = f"clock: {peer} is {clock.offset_ns / NS_PER_S:+.6f} s ± {error_ms:.2f} ms"
    if clock.drift_ppb is not None and clock.drift_error_ppb is not None:
        words += f", drift {clock.drift_ppb / 1000:.1f} ± {clock.drift_error_ppb / 1000:.1f} ppm"
    if clock.restarts:
        words += f"; stepped {clock.restarts} times"
    return words


def clock_lines(collector: Collector) -> Iterator[str]:
    """The line of each gateway of this session whose peer is on another machine."""
    for segment in Segment:
        link = collector.process(collector.topology.gateway(segment).name).link
        if link is not None and link.clock is not None:
            yield clock_words(segment.peer.value, link.clock)
