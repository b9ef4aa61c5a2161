"""The operator's eye and ear: detectors of lights and clicks in what is shown and played."""

from collections import defaultdict
from collections.abc import Mapping

from kontur_av.detect import Click, ClickDetector, Light, LightDetector
from kontur_av.media import BLOCK_NS, I420, CaptureStamp, Pcm
from pipelines.session.probe import Probe
from pipelines.session.rows import ClickRow, LightRow

#: The stream in which to look for lights, and the one in which to listen for clicks.
WATCHED = {"light": "uplink_video", "click": "uplink_voice"}
OPERATORS = frozenset(WATCHED.values())


class Watching:
    """Looks for lights and clicks. Pass it every picture and every block of sound of a display."""

    def __init__(self, probe: Probe) -> None:
        self._probe = probe
        self._eyes: defaultdict[str, LightDetector] = defaultdict(LightDetector)
        self._ears: defaultdict[str, ClickDetector] = defaultdict(ClickDetector)

    def handle_picture(self, stream: str, picture: I420, stamp: CaptureStamp, now_ns: int) -> None:
        """A picture of `stream`, shape (height * 3 // 2, width), is shown at `now_ns`."""
        eye = self._eyes[stream]
        eye.handle_picture(picture, now_ns, stamp.capture_ns)
        while (light := eye.next_event()) is not None:
            tell_light(self._probe, stream, light, _ITSELF)

    def handle_sound(self, stream: str, samples: Pcm, stamp: CaptureStamp, now_ns: int) -> None:
        """A block of sound of `stream` is heard from `now_ns` on."""
        ear = self._ears[stream]
        ear.handle_block(samples, now_ns, stamp.capture_ns)
        while (click := ear.next_event()) is not None:
            tell_click(self._probe, stream, click, _ITSELF)


class _Itself(dict[int, int]):
    """Tags that are capture instants already."""

    def __missing__(self, tag: int) -> int:
        return tag


_ITSELF = _Itself()


def tell_light(probe: Probe, stream: str, light: Light, captured_ns: Mapping[int, int]) -> None:
    """Put a light into the probe. captured_ns: when the pictures were captured, by their tags."""
    try:
        capture_ns = captured_ns[light.tag]
        slack_ns = max(0, capture_ns - captured_ns[light.previous_tag])
    except KeyError:
        # A picture without a capture time was not shown.
        return
    row = LightRow(light.instant_ns, capture_ns, slack_ns, round(light.strength))
    probe.series(LightRow, stream).add(row)


def tell_click(probe: Probe, stream: str, click: Click, captured_ns: Mapping[int, int]) -> None:
    """Put a click into the probe. captured_ns: when the blocks were captured, by their tags."""
    try:
        capture_ns = captured_ns[click.tag]
    except KeyError:
        return
    # Scaled to the captured block, because the playout stretches and shortens blocks.
    capture_ns += click.offset_ns * BLOCK_NS // click.length_ns
    row = ClickRow(click.instant_ns, capture_ns, 0, round(click.strength))
    probe.series(ClickRow, stream).add(row)


class Recall:
    """When the newest pictures or blocks were captured, by their RTP timestamps."""

    def __init__(self, depth: int = 64) -> None:
        self._depth = depth
        self.captured_ns: dict[int, int] = {}

    def add(self, timestamp: int, capture_ns: int) -> None:
        self.captured_ns[timestamp] = capture_ns
        if len(self.captured_ns) > self._depth:
            del self.captured_ns[next(iter(self.captured_ns))]
