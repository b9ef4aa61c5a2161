"""The figures of an input."""

from kontur_av.media import CaptureStamp
from pipelines.media.figures import CaptureFigures
from pipelines.media.taking_over import Takeover
from pipelines.session.probe import Probe


class Capturing:
    """Counts the pictures or blocks of sound of a source."""

    def __init__(self, probe: Probe) -> None:
        self._probe = probe
        self._captured = 0
        self._last_ns: int | None = None

    def handle_captured(self, stamp: CaptureStamp) -> None:
        """The source captured a picture or a block of sound."""
        self._captured += 1
        self._last_ns = stamp.capture_ns

    def tell(self, faults: int = 0, last_fault: str = "", takeover: Takeover | None = None) -> None:
        """Put the counters into the probe, with the faults that the source has survived.

        takeover: of the input, if pages can take it over.
        """
        self._probe.tell(
            CaptureFigures(
                captured=self._captured,
                source_faults=faults,
                from_page=None if takeover is None else takeover.from_page,
                page_refused=None if takeover is None else takeover.refused,
                captured_ns=self._last_ns,
                source_fault=last_fault or None,
                live_source=None if takeover is None else takeover.live_source,
            )
        )
