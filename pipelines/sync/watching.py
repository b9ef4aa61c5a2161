"""The operator's eye and ear: the detectors, fed with what is really shown and played.

Rows for the report: "light.STREAM" and "click.STREAM" are (instant, instant of capture by the
stamps, how much earlier it may have been captured, strength).
"""

from collections.abc import Mapping
from typing import Protocol

from kontur_av.detect import ClickDetector, LightDetector
from kontur_av.media import I420, AudioFrame, CaptureStamp, Pcm, VideoFrame
from pipelines.probe import Probe
from pipelines.sync.figures import SENSES

#: The streams that show the operator where the contacts are.
OPERATORS = frozenset({SENSES["light"], SENSES["click"]})


class Sample(Protocol):
    """What lies in shared memory: a picture or a block of sound."""

    @property
    def stamp(self) -> CaptureStamp: ...

    def video(self) -> VideoFrame: ...

    def audio(self) -> AudioFrame: ...


class Watching:
    """Feed it with every picture and every block of sound of a display."""

    def __init__(self, probe: Probe) -> None:
        self._probe = probe
        self._eyes: dict[str, LightDetector] = {}
        self._ears: dict[str, ClickDetector] = {}

    def handle_sample(self, stream: str, sample: Sample, now_ns: int) -> None:
        """Whatever there is of `stream` is shown, or heard, from `now_ns` on."""
        if stream == SENSES["light"]:
            self.handle_picture(stream, sample.video().data, sample.stamp, now_ns)
        else:
            self.handle_sound(stream, sample.audio().samples, sample.stamp, now_ns)

    def handle_picture(self, stream: str, picture: I420, stamp: CaptureStamp, now_ns: int) -> None:
        """A picture of `stream`, shape (height * 3 // 2, width), is shown at `now_ns`."""
        eye = self._eyes.get(stream)
        if eye is None:
            eye = self._eyes[stream] = LightDetector()
        eye.handle_picture(picture, now_ns, stamp.capture_ns)
        while (light := eye.next_event()) is not None:
            tell_light(
                self._probe,
                stream,
                light.instant_ns,
                light.tag,
                light.previous_tag,
                light.strength,
            )

    def handle_sound(self, stream: str, samples: Pcm, stamp: CaptureStamp, now_ns: int) -> None:
        """A block of sound of `stream` is heard from `now_ns` on."""
        ear = self._ears.get(stream)
        if ear is None:
            ear = self._ears[stream] = ClickDetector()
        ear.handle_block(samples, now_ns, stamp.capture_ns)
        while (click := ear.next_event()) is not None:
            tell_click(
                self._probe,
                stream,
                click.instant_ns,
                click.tag + click.offset_ns,
                click.strength,
            )


def tell_light(
    probe: Probe,
    stream: str,
    instant_ns: int,
    capture_ns: int,
    previous_ns: int,
    strength: float,
) -> None:
    """Put a light into the probe: its first picture's capture, and that of the one before."""
    slack_ns = max(0, capture_ns - previous_ns)
    probe.row(f"light.{stream}", instant_ns, capture_ns, slack_ns, round(strength))


def tell_click(
    probe: Probe, stream: str, instant_ns: int, capture_ns: int, strength: float
) -> None:
    """Put a click into the probe."""
    probe.row(f"click.{stream}", instant_ns, capture_ns, 0, round(strength))


class Recall:
    """The capture instants of the newest pictures or blocks, by their RTP timestamps."""

    def __init__(self, depth: int = 64) -> None:
        self._depth = depth
        self._captured_ns: dict[int, int] = {}

    def add(self, timestamp: int, capture_ns: int) -> None:
        captured_ns = self._captured_ns
        captured_ns[timestamp] = capture_ns
        if len(captured_ns) > self._depth:
            del captured_ns[next(iter(captured_ns))]

    @property
    def captured_ns(self) -> Mapping[int, int]:
        """By timestamp."""
        return self._captured_ns
