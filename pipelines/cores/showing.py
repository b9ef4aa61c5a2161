"""A segment's display and loudspeaker: what was shown, and how old it was."""

from collections.abc import Sequence

from kontur_av.media import CaptureStamp
from pipelines.names import CONCEALED
from pipelines.probe import Probe


class Showing:
    """Counts and times what comes to its end. `streams`: the names of those that do."""

    def __init__(self, streams: Sequence[str], probe: Probe) -> None:
        self._probe = probe
        self._shown = dict.fromkeys(streams, 0)

    def handle_shown(self, stream: str, stamp: CaptureStamp, now_ns: int) -> None:
        """A picture, or a block of sound, is shown at `now_ns`; made up sound does not count."""
        if stamp.source == CONCEALED:
            return
        self._shown[stream] += 1
        self._probe.row(f"shown.{stream}", stamp.sequence, stamp.capture_ns, now_ns)

    def tell(self) -> None:
        """Put the counters into the probe."""
        for stream, shown in self._shown.items():
            self._probe.total(f"{stream}.frames_displayed", shown)
