"""What a gateway tells of the other machine's clock. A core."""

from pipelines.session.probe import Probe
from pipelines.session.rows import ClockRow
from telepresence.link.figures import GatewayFigures


def note_clock(probe: Probe, link: GatewayFigures) -> None:
    """Add a row if the clock of the other machine is known."""
    clock = link.clock
    if clock is not None and clock.offset_ns is not None and clock.error_ns is not None:
        probe.series(ClockRow).add(ClockRow(clock.at_ns, clock.offset_ns, clock.error_ns))
