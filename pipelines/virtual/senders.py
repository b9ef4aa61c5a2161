"""The sending processes of a simulated session: encoding takes its time."""

from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Generic, TypeVar

from kontur_av.codecs.region import Region
from kontur_av.media import AccessUnit, CaptureStamp
from kontur_av.streams.video_sender import VideoSender
from kontur_av.streams.voice_sender import VoiceSender
from pipelines.media.following import CameraFollower, Choice
from pipelines.media.gain import gain_of
from pipelines.media.session_streams import voice_sender
from pipelines.media.stream_figures import Outgoing, tell_sender
from pipelines.media.tip_region import TipRegion
from pipelines.media.video_sending import LinkedVideoSender
from pipelines.session.setup.table import VideoStream, VoiceStream
from pipelines.virtual.agenda import WALL_OFFSET_NS, Timer
from pipelines.virtual.studio import Picture
from pipelines.virtual.workers import Job, Scene, Worker
from telepresence.link.backlog import Backlog
from telepresence.link.gateway import Gateway
from telepresence.world import WorldState

_Sender = TypeVar("_Sender", VideoSender, VoiceSender)


class _SendProcess(Generic[_Sender]):
    """Sends packets that are due, into `gateway`."""

    def __init__(self, scene: Scene, stream: str, sender: _Sender, gateway: Gateway) -> None:
        self._sender: _Sender = sender
        self._agenda = scene.agenda
        self._probe = scene.telling.probe(scene.topology.media(stream).sender)
        self._outgoing = Outgoing(
            sender,
            self._probe,
            partial(gateway.handle_datagram, stream),
            partial(gateway.handle_datagram, f"{stream}_rtcp"),
        )
        #: Whether a picture or block is being encoded.
        self._busy = False
        self._timer = Timer(scene.agenda, self._wake)
        scene.telling.add(self.tell)

    def tell(self) -> None:
        tell_sender(self._probe, self._sender)

    def _wake(self, now_ns: int) -> None:
        self._send_due(now_ns)

    def _send_due(self, now_ns: int) -> None:
        self._outgoing.handle_time(now_ns)
        self._timer.set(self._sender.poll_timeout(), now_ns)


class VideoProcess(_SendProcess[VideoSender]):
    """Sends access units: those of a recording, each at its instant."""

    def __init__(
        self, scene: Scene, stream: VideoStream, sender: VideoSender, gateway: Gateway
    ) -> None:
        super().__init__(scene, stream.name, sender, gateway)
        self._linked = LinkedVideoSender(sender, gain_of(scene.setup, stream))
        self.handle_feedback = sender.handle_feedback

    def tell(self) -> None:
        tell_sender(self._probe, self._sender, self._linked.gain)

    def handle_unit(self, unit: AccessUnit, now_ns: int) -> None:
        self._sender.handle_coded(unit, now_ns)
        self._send_due(now_ns)

    def handle_backlog(self, backlog: Backlog, now_ns: int) -> None:
        """The gateway's report, which can only raise the cap."""
        self._linked.handle_backlog(backlog, now_ns, now_ns)


class VideoSendProcess(VideoProcess):
    """Encodes the newest picture when the stream's budget has room for one.

    Packets leave meanwhile: the live process encodes in a thread.
    """

    def __init__(
        self,
        scene: Scene,
        stream: VideoStream,
        sender: VideoSender,
        gateway: Gateway,
        studio: Worker,
    ) -> None:
        super().__init__(scene, stream, sender, gateway)
        self._studio, self._cost_ns = studio, scene.costs.ns("encode")
        self._newest: tuple[Picture, CaptureStamp] | None = None
        #: Of a sender that follows the selected camera.
        self.follower: CameraFollower | None = None
        self.on_confirmed: Callable[[int, int], None] | None = None
        #: With the newest state of the robot: where pictures are coded finer.
        self.tip: tuple[TipRegion, Callable[[int], WorldState]] | None = None
        self._reported: tuple[Backlog, int] | None = None

    def handle_picture(self, picture: Picture, stamp: CaptureStamp, now_ns: int) -> None:
        """A picture comes, and replaces the one before if that was not encoded."""
        self._newest = picture, stamp
        self._sender.handle_picture(stamp, now_ns)
        self._wake(now_ns)

    def handle_backlog(self, backlog: Backlog, now_ns: int) -> None:
        """The gateway's report. It wakes nobody: the process looks at it when it wakes up."""
        self._reported = backlog, now_ns

    def handle_choice(self, choice: Choice, now_ns: int) -> None:
        """The selector says which camera to take."""
        assert self.follower is not None
        if self.follower.handle_choice(choice):
            self._newest = None
        self._confirm(now_ns)

    def _confirm(self, now_ns: int) -> None:
        """Tell the selector of a choice when nothing of another camera is under way."""
        follower = self.follower
        if follower is None:
            return
        idle = not self._busy and not self._sender.backlog_octets
        ended = follower.handle_sender(idle=idle)
        number = follower.poll_confirmed(now_ns)
        if number is not None and self.on_confirmed is not None:
            self.on_confirmed(number, now_ns)
        if ended:
            self._look(now_ns)

    def _send_due(self, now_ns: int) -> None:
        super()._send_due(now_ns)
        self._confirm(now_ns)

    def _wake(self, now_ns: int) -> None:
        self._read_backlog(now_ns)
        self._look(now_ns)
        self._send_due(now_ns)

    def _read_backlog(self, now_ns: int) -> None:
        if self._reported is not None:
            (backlog, told_ns), self._reported = self._reported, None
            self._linked.handle_backlog(backlog, told_ns, now_ns)

    def _look(self, now_ns: int) -> None:
        if self._busy or self._newest is None:
            return
        if self.follower is not None and self.follower.leaving:
            return
        coding = self._linked.poll_encode(now_ns)
        if coding is None:
            return
        (picture, stamp), self._newest = self._newest, None
        self._busy = True
        job = self._studio.submit((picture, coding, self._region(now_ns)))
        self._agenda.at(now_ns + self._cost_ns, partial(self._finish, job, stamp))

    def _region(self, now_ns: int) -> Region | None:
        if self.tip is None or self.follower is None:
            return None
        tip, state_at = self.tip
        state = state_at(now_ns)
        tip.handle_tip(state.x_m, state.y_m, state.time_ns)
        return tip.region(self.follower.camera, now_ns)

    def _finish(self, job: Job, stamp: CaptureStamp, now_ns: int) -> None:
        data, keyframe = job.result()
        self._read_backlog(now_ns)
        self._sender.handle_access_unit(AccessUnit(data, stamp, keyframe), now_ns)
        self._busy = False
        self._send_due(now_ns)
        self._look(now_ns)


class VoiceProcess(_SendProcess[VoiceSender]):
    """Sends Opus packets: those of a recording, each at its instant."""

    def __init__(self, scene: Scene, stream: VoiceStream) -> None:
        identity, gateway = scene.identity(stream.name), scene.sending_gateway(stream.name)
        sender = voice_sender(scene.setup, stream, identity, wall_offset_ns=WALL_OFFSET_NS)
        super().__init__(scene, stream.name, sender, gateway)

    def handle_packet(self, opus: bytes, stamp: CaptureStamp, now_ns: int) -> None:
        if self._sender.handle_block(stamp, now_ns):
            self._sender.handle_packet(opus, stamp, now_ns)
        self._send_due(now_ns)


class VoiceSendProcess(VoiceProcess):
    """Encodes every block of sound as it comes.

    No packet leaves meanwhile, as in the live process.
    """

    def __init__(self, scene: Scene, stream: VoiceStream, studio: Worker) -> None:
        super().__init__(scene, stream)
        self._studio, self._cost_ns = studio, scene.costs.ns("voice_encode")
        self._waiting: deque[tuple[CaptureStamp, WorldState | None]] = deque(maxlen=8)

    def handle_sound(self, stamp: CaptureStamp, state: WorldState | None, now_ns: int) -> None:
        """A block of sound is complete; state: of the world, None for a file's."""
        self._waiting.append((stamp, state))
        self._look(now_ns)

    def _wake(self, now_ns: int) -> None:
        if not self._busy:
            self._send_due(now_ns)

    def _look(self, now_ns: int) -> None:
        while self._waiting and not self._busy:
            stamp, state = self._waiting.popleft()
            if not self._sender.handle_block(stamp, now_ns):
                continue
            self._busy = True
            job = self._studio.submit((stamp.sequence, now_ns, state))
            self._agenda.at(now_ns + self._cost_ns, partial(self._finish, job, stamp))

    def _finish(self, job: Job, stamp: CaptureStamp, now_ns: int) -> None:
        self._sender.handle_packet(job.result(), stamp, now_ns)
        self._busy = False
        self._send_due(now_ns)
        self._look(now_ns)
