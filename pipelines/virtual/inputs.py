"""The inputs of a simulated session: when each captures, and what it sees or hears."""

from collections.abc import Callable
from functools import partial
from typing import cast

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ConfigError
from kontur_av.media import I420, CaptureStamp, VideoFrame
from kontur_av.sources import BLOCK_NS
from kontur_av.sources.pace import Pace
from kontur_av.sources.page import PAGE
from kontur_av.sources.stereo import StereoPairer
from pipelines.media.capturing import Capturing
from pipelines.media.figures import StereoFigures
from pipelines.session.setup.sources import check_sources
from pipelines.session.setup.table import STEREO, VOICE_PACKETS_PER_S, Setup
from pipelines.virtual.studio import Picture, Shot
from pipelines.virtual.workers import Job, Scene, Worker
from telepresence.world import WorldState

#: Takes a captured picture: (picture, stamp, now), or a block of sound: (stamp, world, now). The
#: world is None for a file's.
ShowPicture = Callable[[Picture, CaptureStamp, int], None]
ShowSound = Callable[[CaptureStamp, WorldState | None, int], None]


def check_virtual_sources(setup: Setup) -> None:
    """ConfigError for an input that cannot be opened, or exists in real time only: a pipe, say."""
    for name in setup.inputs:
        kind, colon, _ = setup.source(name).partition(":")
        if (colon and kind in ("pipe", "v4l2", "alsa")) or setup.source(name) == PAGE:
            raise ConfigError(
                f"input {name}: {setup.source(name)} lives in real time; "
                "a simulation takes scene:NAME, a media file or mcap:FILE#CHANNEL"
            )
    check_sources(setup, setup.inputs)


class _Input:
    """Captures at its instants, with or without readers.

    film: plays its file; None for a scene, which is captured at `pace`. take: called with each.
    job: asks for the file's next picture or block. block_ns: what is captured began so long before.
    """

    def __init__(
        self,
        scene: Scene,
        name: str,
        film: Worker | None,
        pace: Pace,
        take: ShowSound,
        *,
        job: str | None = None,
        block_ns: int = 0,
    ) -> None:
        self._name, self._agenda, self._state_at = name, scene.agenda, scene.state_at
        self._film, self._pace, self._take = film, pace, take
        self._job, self._block_ns = job, block_ns
        self._coming: Job | None = None
        self._sequence = 0
        self._capturing = Capturing(scene.telling.probe(scene.topology.input(name).process))
        scene.telling.add(self._capturing.tell)
        if film is None:
            self._agenda.at(pace.due_ns(scene.start_ns), self._capture)
        else:
            self._ask(film)
            self._agenda.at(scene.start_ns, self._wait)

    def _ask(self, film: Worker) -> None:
        """Begin to prepare the file's next picture or block."""
        self._coming = film.submit(self._job)

    def _stamp(self, capture_ns: int) -> CaptureStamp:
        stamp = CaptureStamp(capture_ns, self._sequence, self._name)
        self._sequence += 1
        self._capturing.handle_captured(stamp)
        return stamp

    def _capture(self, now_ns: int) -> None:
        self._take(self._stamp(now_ns - self._block_ns), self._state_at(now_ns), now_ns)
        self._pace.handle_taken()
        self._agenda.at(self._pace.due_ns(now_ns), self._capture)

    def _wait(self, now_ns: int) -> None:
        assert self._coming is not None and self._film is not None
        capture_ns = self._coming.result()
        if capture_ns is not None:
            self._ask(self._film)
            self._agenda.at(max(capture_ns + self._block_ns, now_ns), self._play)

    def _play(self, now_ns: int) -> None:
        self._take(self._stamp(now_ns - self._block_ns), None, now_ns)
        self._wait(now_ns)


class Camera(_Input):
    """Captures pictures of a scene at its rate, or pictures of a file at the file's instants.

    film: plays the file; None for a scene. show: called the cost of a capture after each.
    """

    def __init__(
        self, scene: Scene, name: str, fps: int, film: Worker | None, show: ShowPicture
    ) -> None:
        self._cost_ns, self._show = scene.costs.ns("capture"), show
        # All cameras capture at the same instants. Live scenes have phases to spread the load of
        # the machine; here the encoders of the same instant share the cores.
        super().__init__(scene, name, film, Pace(fps, scene.start_ns), self._shoot, job=name)

    def _shoot(self, stamp: CaptureStamp, state: WorldState | None, now_ns: int) -> None:
        shots = (Shot(self._name, stamp.sequence, state),)
        self._agenda.at(now_ns + self._cost_ns, partial(self._show, shots, stamp))


class Microphone(_Input):
    """Captures sound in blocks of 20 ms. film: as of `Camera`. show: called with a whole block."""

    def __init__(self, scene: Scene, name: str, film: Worker | None, show: ShowSound) -> None:
        pace = Pace(VOICE_PACKETS_PER_S, scene.start_ns, patience=2)
        super().__init__(scene, name, film, pace, show, block_ns=BLOCK_NS)


class Stereo:
    """Pairs the pictures of the two cameras. Drawing comes later, when a pair is encoded."""

    def __init__(self, scene: Scene, fps: int, show: ShowPicture) -> None:
        self._pairer = StereoPairer(period_ns=NS_PER_S // fps)
        self._agenda, self._show = scene.agenda, show
        merged = scene.topology.topic(scene.topology.camera(STEREO).topic)
        self._probe = scene.telling.probe(merged.writer)
        scene.telling.add(self.tell)

    def handle_picture(
        self, picture: Picture, stamp: CaptureStamp, now_ns: int, *, right: bool
    ) -> None:
        """One of the two cameras has a picture."""
        handle = self._pairer.handle_right if right else self._pairer.handle_left
        # The pairer reads stamps only, so a Shot can stand in for a picture.
        handle(VideoFrame(cast(I420, picture[0]), stamp), now_ns)
        self._give(now_ns)
        due_ns = self._pairer.poll_timeout()
        if due_ns is not None:
            self._agenda.at(max(due_ns, now_ns + 1), self._expire)

    def _expire(self, now_ns: int) -> None:
        self._pairer.handle_timeout(now_ns)
        self._give(now_ns)

    def _give(self, now_ns: int) -> None:
        while (pair := self._pairer.next_event()) is not None:
            left, right = (
                None if frame is None else cast(Shot, frame.data)
                for frame in (pair.left, pair.right)
            )
            self._show((left, right), pair.stamp, now_ns)

    def tell(self) -> None:
        """Put the counters into the probe."""
        pairer = self._pairer
        self._probe.tell(StereoFigures(paired=pairer.paired, single=pairer.single))
