"""The sending and receiving processes of a simulated session. Coding takes its time.

Nothing on the link depends on the output of a decoder. So decoders work while virtual time goes on,
and the simulation waits for them only when figures are reported (`settle`).
"""

from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Generic, TypeVar

from kontur_av.codecs.decoder import DecoderCounts
from kontur_av.codecs.region import Region
from kontur_av.media import AccessUnit, CaptureStamp
from kontur_av.rtp.nal_payload import ReceivedUnit
from kontur_av.rtp.playout import PlayoutBlock
from kontur_av.streams.video_receiver import VideoReceiver
from kontur_av.streams.video_sender import VideoSender
from kontur_av.streams.voice_receiver import VoiceReceiver
from kontur_av.streams.voice_sender import VoiceSender
from pipelines.media.following import CameraFollower, Choice, TipRegion
from pipelines.media.gain import LinkedVideoSender, gain_of
from pipelines.media.showing import OPERATORS, Recall, Showing, publish_click, publish_light
from pipelines.media.stream_metrics import (
    Outgoing,
    note_arrivals,
    note_unit,
    publish_sender,
    video_receiver,
    voice_receiver,
    voice_sender,
)
from pipelines.session.setup.table import VideoStream, VoiceStream
from pipelines.virtual.studio import Picture, VoiceDecoding
from pipelines.virtual.workers import WALL_OFFSET_NS, Batch, Coder, Job, Scene, Timer, Worker
from telepresence.link.gateway import Backlog, Gateway
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
        scene.telling.add(self.publish)

    def publish(self) -> None:
        publish_sender(self._probe, self._sender)

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

    def publish(self) -> None:
        publish_sender(self._probe, self._sender, self._linked.gain)

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
        self._studio, self._cost_ns = studio, scene.costs.picture_ns("encode", stream.codec)
        self._codec = stream.codec
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
        self._sender.handle_access_unit(AccessUnit(data, stamp, keyframe, self._codec), now_ns)
        self._busy = False
        self._send_due(now_ns)
        self._look(now_ns)


class VoiceProcess(_SendProcess[VoiceSender]):
    """Sends Opus packets: those of a recording, each at its instant."""

    def __init__(self, scene: Scene, stream: VoiceStream) -> None:
        identity, gateway = scene.identity(stream.name), scene.sending_gateway(stream.name)
        sender = voice_sender(scene.setup, stream, identity, wall_offset_ns=WALL_OFFSET_NS)
        super().__init__(scene, stream.name, sender, gateway)

    def handle_unit(self, unit: AccessUnit, now_ns: int) -> None:
        if self._sender.handle_block(unit.stamp, now_ns):
            self._sender.handle_packet(unit.data, unit.stamp, now_ns)
        self._send_due(now_ns)


class VoiceSendProcess(VoiceProcess):
    """Encodes every block of sound as it comes.

    No packet leaves meanwhile, as in the live process.
    """

    def __init__(self, scene: Scene, stream: VoiceStream) -> None:
        super().__init__(scene, stream)
        self._cost_ns = scene.costs.ns("voice_encode")
        self._waiting: deque[tuple[CaptureStamp, Job]] = deque(maxlen=8)

    def handle_sound(self, stamp: CaptureStamp, job: Job, now_ns: int) -> None:
        """A block of sound is complete; job: encodes it."""
        self._waiting.append((stamp, job))
        self._look(now_ns)

    def _wake(self, now_ns: int) -> None:
        if not self._busy:
            self._send_due(now_ns)

    def _look(self, now_ns: int) -> None:
        while self._waiting and not self._busy:
            stamp, job = self._waiting.popleft()
            if not self._sender.handle_block(stamp, now_ns):
                continue
            self._busy = True
            self._agenda.at(now_ns + self._cost_ns, partial(self._finish, job, stamp))

    def _finish(self, job: Job, stamp: CaptureStamp, now_ns: int) -> None:
        self._sender.handle_packet(job.result(), stamp, now_ns)
        self._busy = False
        self._send_due(now_ns)
        self._look(now_ns)


class Display:
    """A display whose pictures are never drawn; it is decided all the same when each would be."""

    def __init__(self, showing: Showing) -> None:
        self._showing = showing
        self.probe = showing.probe

    def handle_shown(self, stream: str, stamp: CaptureStamp, now_ns: int) -> None:
        self._showing.handle_shown(stream, stamp, now_ns)
        self._draw()

    def handle_time(self, until_ns: int) -> None:
        """Mark what is stale up to `until_ns`, each time at its instant."""
        while (due_ns := self._showing.poll_timeout()) is not None and due_ns <= until_ns:
            self._showing.handle_time(due_ns)
            self._draw()

    def _draw(self) -> None:
        while self._showing.next_event() is not None:
            pass


_Receiver = TypeVar("_Receiver", VideoReceiver, VoiceReceiver)


class _ReceiveProcess(Generic[_Receiver]):
    """Receives RTP and reports. make: makes the decoder, in the process of its worker."""

    def __init__(
        self,
        scene: Scene,
        stream: str,
        receiver: _Receiver,
        display: Display,
        make: Callable[[], Coder],
    ) -> None:
        self._receiver: _Receiver = receiver
        self._stream, self._display = stream, display
        self._agenda = scene.agenda
        self._probe = scene.telling.probe(scene.topology.media(stream).receiver)
        self._decoder = Batch(scene.workers.start(make))
        self._recall = Recall()
        self._timer = Timer(scene.agenda, self._expire)
        scene.telling.add(self.publish)

    def publish(self) -> None:
        self._probe.publish(self._receiver.counts)

    def handle_packet(self, datagram: bytes, now_ns: int) -> None:
        self._receiver.handle_packet(datagram, now_ns)
        self._drain(now_ns)

    def handle_report(self, datagram: bytes, now_ns: int) -> None:
        self._receiver.handle_report(datagram, now_ns)
        self._drain(now_ns)

    def _expire(self, now_ns: int) -> None:
        self._drain(now_ns)

    def _drain(self, now_ns: int) -> None:
        raise NotImplementedError


class VideoReceiveProcess(_ReceiveProcess[VideoReceiver]):
    """Decodes every access unit, and shows the pictures."""

    def __init__(
        self, scene: Scene, stream: VideoStream, display: Display, make: Callable[[], Coder]
    ) -> None:
        ssrc = scene.random(f"{stream.name} receiver").getrandbits(32)
        receiver = video_receiver(stream, ssrc=ssrc, wall_offset_ns=WALL_OFFSET_NS)
        super().__init__(scene, stream.name, receiver, display, make)
        row = scene.topology.video(stream.name)
        far = scene.gateways[row.direction.receiver]
        self._ask = partial(far.handle_datagram, row.feedback)
        #: Called with (instant, latency) of each picture when it is shown.
        self.on_shown: Callable[[int, int], None] | None = None
        #: Called with each access unit that was received.
        self.on_unit: Callable[[ReceivedUnit], None] | None = None
        #: PSNR of each picture against its original, where that is known.
        self.quality_db: list[float] = []
        self._cost_ns = scene.costs.picture_ns("decode", stream.codec)
        self._free_ns = 0
        self._decoding: deque[tuple[int, int, int | None]] = deque()
        self._counts = DecoderCounts()

    def publish(self) -> None:
        super().publish()
        self._probe.publish(self._counts)

    def _expire(self, now_ns: int) -> None:
        self._receiver.handle_timeout(now_ns)
        self._drain(now_ns)

    def _drain(self, now_ns: int) -> None:
        while (unit := self._receiver.next_event()) is not None:
            note_unit(self._probe, unit)
            if self.on_unit is not None:
                self.on_unit(unit)
            # One at a time, as in the live process.
            self._free_ns = max(now_ns, self._free_ns) + self._cost_ns
            self._decoder.submit((unit.data, unit.timestamp, self._free_ns))
            self._agenda.at(self._free_ns, partial(self._date, unit.timestamp))
        feedback = self._receiver.poll_feedback(now_ns)
        if feedback is not None:
            self._ask(feedback, now_ns)
        self._timer.set(self._receiver.poll_timeout(), now_ns)

    def _date(self, timestamp: int, now_ns: int) -> None:
        capture_ns = self._receiver.capture_ns(timestamp)
        self._decoding.append((now_ns, timestamp, capture_ns))
        if self.on_shown is not None and capture_ns is not None:
            self.on_shown(now_ns, now_ns - capture_ns)

    def settle(self, until_ns: int) -> None:
        """Wait for pictures decoded by `until_ns`, and show each at its own instant."""
        while self._decoding and self._decoding[0][0] <= until_ns:
            shown_ns, timestamp, dated_ns = self._decoding.popleft()
            pictures, self._counts, lights, quality = self._decoder.next_result()
            self.quality_db.extend(quality)
            for of, width, height, corrupt in pictures:
                capture_ns = dated_ns if of == timestamp else self._receiver.capture_ns(of)
                stamp = self._receiver.handle_picture(
                    of, width, height, capture_ns, corrupt=corrupt
                )
                if stamp is not None:
                    # The marks on the picture before come first.
                    self._display.handle_time(shown_ns - 1)
                    self._display.handle_shown(self._stream, stamp, shown_ns)
                    self._recall.add(of, stamp.capture_ns)
            for light in lights:
                publish_light(self._display.probe, self._stream, light, self._recall.captured_ns)


class VoiceReceiveProcess(_ReceiveProcess[VoiceReceiver]):
    """Plays each block of sound at its instant."""

    def __init__(self, scene: Scene, stream: VoiceStream, display: Display) -> None:
        receiver = voice_receiver(scene.topology, stream, wall_offset_ns=WALL_OFFSET_NS)
        make = partial(VoiceDecoding, watched=stream.name in OPERATORS)
        super().__init__(scene, stream.name, receiver, display, make)
        self._cost_ns = scene.costs.ns("voice_decode")
        self._decoding: deque[tuple[int, PlayoutBlock, int | None]] = deque()
        self.handle_picture_shown = receiver.handle_picture_shown

    def _drain(self, now_ns: int) -> None:
        note_arrivals(self._probe, self._receiver)
        self._receiver.handle_timeout(now_ns)
        while (block := self._receiver.next_event()) is not None:
            heard_ns = now_ns + self._cost_ns
            self._decoder.submit((block, heard_ns))
            capture_ns = self._receiver.capture_ns(block.timestamp)
            self._decoding.append((heard_ns, block, capture_ns))
        self._timer.set(self._receiver.poll_timeout(), now_ns)

    def settle(self, until_ns: int) -> None:
        """Wait for blocks decoded by `until_ns`, and play each at its own instant."""
        while self._decoding and self._decoding[0][0] <= until_ns:
            heard_ns, block, capture_ns = self._decoding.popleft()
            decoded, clicks = self._decoder.next_result()
            stamp = self._receiver.handle_sound(block, decoded=decoded, capture_ns=capture_ns)
            if stamp is not None:
                self._display.handle_shown(self._stream, stamp, heard_ns)
                self._recall.add(block.timestamp, stamp.capture_ns)
            for click in clicks:
                publish_click(self._display.probe, self._stream, click, self._recall.captured_ns)
