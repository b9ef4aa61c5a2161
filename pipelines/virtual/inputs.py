"""The inputs of a simulated session: when each captures, and what it sees or hears."""

from collections.abc import Callable
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
from pipelines.session.probe import Probe
from pipelines.session.setup.sources import check_sources
from pipelines.session.setup.table import VOICE_PACKETS_PER_S, Setup
from pipelines.virtual.agenda import Agenda
from pipelines.virtual.studio import Picture, Shot
from pipelines.virtual.workers import Job, Worker
from telepresence.world import WorldState

#: Takes a captured picture: (picture, stamp, now), or a block of sound: (stamp, world, now).
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
    """Base of both kinds of inputs: it captures at its instants, with or without readers."""

    def __init__(self, name: str, agenda: Agenda, worker: Worker | None, probe: Probe) -> None:
        self._name = name
        self._agenda = agenda
        self._film = worker
        self._coming: Job | None = None
        self._sequence = 0
        self._capturing = Capturing(probe)
        self.tell = self._capturing.tell

    def _ask(self, job: str | None) -> None:
        """Begin to prepare the file's next picture or block."""
        if self._film is not None:
            self._coming = self._film.submit(job)

    def _stamp(self, capture_ns: int) -> CaptureStamp:
        stamp = CaptureStamp(capture_ns, self._sequence, self._name)
        self._sequence += 1
        self._capturing.handle_captured(stamp)
        return stamp


class Camera(_Input):
    """Captures pictures of a scene at its rate, or pictures of a file at the file's instants.

    worker: plays the file; None for a scene. show: called `cost_ns` after each capture.
    """

    def __init__(
        self,
        name: str,
        fps: int,
        *,
        agenda: Agenda,
        worker: Worker | None,
        probe: Probe,
        state_at: Callable[[int], WorldState],
        cost_ns: int,
        show: ShowPicture,
        now_ns: int,
    ) -> None:
        super().__init__(name, agenda, worker, probe)
        self._state_at = state_at
        self._cost_ns = cost_ns
        self._show = show
        if worker is None:
            # All cameras capture at the same instants. Live scenes have phases to spread the load
            # of the machine; here the encoders of the same instant share the cores.
            self._pace = Pace(fps, now_ns)
            agenda.at(self._pace.due_ns(now_ns), self._capture)
        else:
            self._ask(name)
            agenda.at(now_ns, self._wait)

    def _capture(self, now_ns: int) -> None:
        stamp = self._stamp(now_ns)
        self._publish(Shot(self._name, stamp.sequence, self._state_at(now_ns)), stamp)
        self._pace.handle_taken()
        self._agenda.at(self._pace.due_ns(now_ns), self._capture)

    def _wait(self, now_ns: int) -> None:
        assert self._coming is not None
        capture_ns = self._coming.result()
        if capture_ns is not None:
            self._ask(self._name)
            self._agenda.at(max(capture_ns, now_ns), self._play)

    def _play(self, now_ns: int) -> None:
        stamp = self._stamp(now_ns)
        self._publish(Shot(self._name, stamp.sequence, None), stamp)
        self._wait(now_ns)

    def _publish(self, shot: Shot, stamp: CaptureStamp) -> None:
        show = self._show
        self._agenda.at(stamp.capture_ns + self._cost_ns, lambda now: show((shot,), stamp, now))


class Microphone(_Input):
    """Captures sound in blocks of 20 ms. show: called when a block is complete."""

    def __init__(
        self,
        name: str,
        *,
        agenda: Agenda,
        worker: Worker | None,
        probe: Probe,
        state_at: Callable[[int], WorldState],
        show: ShowSound,
        now_ns: int,
    ) -> None:
        super().__init__(name, agenda, worker, probe)
        self._state_at = state_at
        self._show = show
        if worker is None:
            self._pace = Pace(VOICE_PACKETS_PER_S, now_ns, patience=2)
            agenda.at(self._pace.due_ns(now_ns), self._capture)
        else:
            self._ask(None)
            agenda.at(now_ns, self._wait)

    def _capture(self, now_ns: int) -> None:
        self._show(self._stamp(now_ns - BLOCK_NS), self._state_at(now_ns), now_ns)
        self._pace.handle_taken()
        self._agenda.at(self._pace.due_ns(now_ns), self._capture)

    def _wait(self, now_ns: int) -> None:
        assert self._coming is not None
        capture_ns = self._coming.result()
        if capture_ns is not None:
            self._ask(None)
            self._agenda.at(max(capture_ns + BLOCK_NS, now_ns), self._play)

    def _play(self, now_ns: int) -> None:
        self._show(self._stamp(now_ns - BLOCK_NS), None, now_ns)
        self._wait(now_ns)


class Stereo:
    """Pairs the pictures of the two cameras. Drawing comes later, when a pair is encoded."""

    def __init__(self, fps: int, *, agenda: Agenda, probe: Probe, show: ShowPicture) -> None:
        self._pairer = StereoPairer(period_ns=NS_PER_S // fps)
        self._agenda = agenda
        self._probe = probe
        self._show = show

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
