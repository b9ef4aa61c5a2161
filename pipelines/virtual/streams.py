"""The sending and receiving processes of a simulated session. Coding takes its time."""

from collections import deque
from collections.abc import Callable
from dataclasses import replace
from functools import partial

from kontur_av.media import AccessUnit, CaptureStamp
from kontur_av.rtp.nal_depacketizer import ReceivedUnit
from kontur_av.rtp.playout import PlayoutBlock
from pipelines.media.following import Choice
from pipelines.media.showing import OPERATORS, Recall, Showing, publish_click, publish_light
from pipelines.media.stream_metrics import (
    Outgoing,
    note_arrivals,
    publish_sender,
    voice_receiver,
    voice_sender,
)
from pipelines.media.video_ends import VideoReceiveEnd, VideoSendEnd
from pipelines.session.process import wait_ns
from pipelines.session.setup.table import VideoStream, VoiceStream
from pipelines.virtual.studio import Picture, VoiceDecoding
from pipelines.virtual.workers import WALL_OFFSET_NS, Coder, Job, Scene, Timer, Worker
from telepresence.link.gateway import Backlog, Gateway
from telepresence.world import WorldState

#: Takes a datagram, at its instant.
Consumer = Callable[[bytes, int], object]


def _to_gateway(gateway: Gateway, stream: str) -> tuple[Consumer, Consumer]:
    """What sends a stream's packets, and what sends its reports."""
    take = gateway.handle_datagram
    return partial(take, stream), partial(take, f"{stream}_rtcp")


class VideoSendProcess:
    """Encodes the newest picture when the stream's budget has room for one.

    Packets leave meanwhile: the live process encodes in a thread.

    studio: draws and encodes; None for a stream of recorded units. robot: its newest state.
    """

    def __init__(
        self,
        scene: Scene,
        stream: VideoStream,
        studio: Worker | None = None,
        *,
        follows: bool = False,
        robot: Callable[[], WorldState | None] = lambda: None,
    ) -> None:
        self._agenda, self._studio, self._robot = scene.agenda, studio, robot
        self._cost_ns = scene.costs.picture_ns("encode", stream.codec)
        self.end = VideoSendEnd[Picture](
            scene.setup,
            stream,
            scene.identity(stream.name),
            scene.telling.probe(scene.topology.media(stream.name).sender),
            _to_gateway(scene.sending_gateway(stream.name), stream.name),
            wall_offset_ns=WALL_OFFSET_NS,
            follows=follows,
        )
        self._timer = Timer(scene.agenda, self._step)
        scene.telling.add(self.end.publish)
        scene.at_end.append(self.end.close)
        self.on_confirmed: Callable[[int, int], None] | None = None
        #: The gateway's report wakes nobody: the process looks at it when it wakes up.
        self._reported: tuple[Backlog, int] | None = None

    def handle_backlog(self, backlog: Backlog, now_ns: int) -> None:
        self._reported = backlog, now_ns

    def handle_feedback(self, datagram: bytes, now_ns: int) -> None:
        self.end.handle_feedback(datagram, now_ns)
        self._step(now_ns)

    def handle_choice(self, choice: Choice, now_ns: int) -> None:
        self.end.handle_choice(choice)
        self._step(now_ns)

    def handle_picture(self, picture: Picture, stamp: CaptureStamp, now_ns: int) -> None:
        self.end.handle_picture(picture, stamp, now_ns)
        self._step(now_ns)

    def handle_coded(self, unit: AccessUnit, now_ns: int) -> None:
        """A recorded unit comes."""
        self.end.handle_coded(unit, now_ns)
        self._step(now_ns)

    def _step(self, now_ns: int, done: AccessUnit | None = None) -> None:
        end = self.end
        if self._reported is not None:
            (backlog, told_ns), self._reported = self._reported, None
            end.handle_backlog(backlog, told_ns, now_ns)
        end.handle_time(now_ns)
        if done is not None:
            end.handle_unit(done, now_ns, now_ns)
        if (number := end.poll_confirmed(now_ns)) is not None and self.on_confirmed is not None:
            self.on_confirmed(number, now_ns)
        if (state := self._robot()) is not None:
            end.handle_state(state)
        if self._studio is not None and (work := end.poll_encode(now_ns)) is not None:
            job = self._studio.submit((work.picture, work.coding, work.region))
            self._agenda.at(now_ns + self._cost_ns, partial(self._finish, job, work.stamp))
        self._timer.set(now_ns + wait_ns(now_ns, end.poll_timeout(now_ns)), now_ns)

    def _finish(self, job: Job, stamp: CaptureStamp, now_ns: int) -> None:
        self._step(now_ns, replace(job.result(), stamp=stamp))


class VoiceProcess:
    """Sends Opus packets: those of a recording, each at its instant."""

    def __init__(self, scene: Scene, stream: VoiceStream) -> None:
        identity = scene.identity(stream.name)
        self._sender = sender = voice_sender(
            scene.setup, stream, identity, wall_offset_ns=WALL_OFFSET_NS
        )
        probe = scene.telling.probe(scene.topology.media(stream.name).sender)
        to_gateway = _to_gateway(scene.sending_gateway(stream.name), stream.name)
        self._outgoing = Outgoing(sender, probe, *to_gateway)
        self._agenda = scene.agenda
        #: Whether a block is being encoded.
        self._busy = False
        self._timer = Timer(scene.agenda, self._wake)
        scene.telling.add(lambda: publish_sender(probe, sender))
        scene.at_end.append(self._outgoing.close)

    def handle_backlog(self, backlog: Backlog, now_ns: int) -> None:
        self._sender.handle_contacts(backlog.contacts, now_ns)

    def handle_coded(self, unit: AccessUnit, now_ns: int) -> None:
        """A recorded unit comes."""
        if self._sender.handle_block(unit.stamp, now_ns):
            self._sender.handle_packet(unit.data, unit.stamp, now_ns)
        self._send_due(now_ns)

    def _wake(self, now_ns: int) -> None:
        self._send_due(now_ns)

    def _send_due(self, now_ns: int) -> None:
        self._outgoing.handle_time(now_ns)
        self._timer.set(self._sender.poll_timeout(), now_ns)


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

    def __init__(self, scene: Scene, showing: Showing) -> None:
        self._showing, self.probe = showing, showing.probe
        self._timer = Timer(scene.agenda, self._mark)

    def handle_shown(self, stream: str, stamp: CaptureStamp, now_ns: int) -> None:
        self._showing.handle_shown(stream, stamp, now_ns)
        self._draw(now_ns)

    def _mark(self, now_ns: int) -> None:
        self._showing.handle_time(now_ns)
        self._draw(now_ns)

    def _draw(self, now_ns: int) -> None:
        while self._showing.next_event() is not None:
            pass
        self._timer.set(self._showing.poll_timeout(), now_ns)


class VideoReceiveProcess:
    """Decodes every access unit, and shows the pictures. What comes meanwhile waits.

    make: makes the decoder, in the process of its worker.
    """

    def __init__(
        self, scene: Scene, stream: VideoStream, display: Display, make: Callable[[], Coder]
    ) -> None:
        row = scene.topology.video(stream.name)
        self.end = end = VideoReceiveEnd(
            stream,
            scene.telling.probe(row.receiver),
            ssrc=scene.random(f"{stream.name} receiver").getrandbits(32),
            wall_offset_ns=WALL_OFFSET_NS,
        )
        self._stream, self._display, self._agenda = stream.name, display, scene.agenda
        self._decoder, self._recall = scene.workers.start(make), Recall()
        self._cost_ns = scene.costs.picture_ns("decode", stream.codec)
        far = scene.gateways[row.direction.receiver]
        self._ask = partial(far.handle_datagram, row.feedback)
        self._timer = Timer(scene.agenda, self._step)
        scene.telling.add(end.publish)
        #: What came while a unit was decoded; None: no unit is being decoded.
        self._waiting: list[tuple[Callable[[bytes, int], object], bytes]] | None = None
        #: Called with (instant, latency) of each picture when it is shown.
        self.on_shown: list[Callable[[int, int], object]] = []
        #: Called with each access unit that was received.
        self.on_unit: Callable[[ReceivedUnit], None] | None = None
        #: PSNR of each picture against its original, where that is known.
        self.quality_db: list[float] = []

    def handle_packet(self, datagram: bytes, now_ns: int) -> None:
        self._take(self.end.handle_packet, datagram, now_ns)

    def handle_report(self, datagram: bytes, now_ns: int) -> None:
        self._take(self.end.handle_report, datagram, now_ns)

    def _take(self, take: Callable[[bytes, int], object], datagram: bytes, now_ns: int) -> None:
        if self._waiting is not None:
            self._waiting.append((take, datagram))
            return
        take(datagram, now_ns)
        self._step(now_ns)

    def _step(self, now_ns: int) -> None:
        if self._waiting is not None:
            return
        end = self.end
        end.handle_timeout(now_ns)
        if (unit := end.next_unit()) is not None:
            self._decode(unit, now_ns)
            return
        if (feedback := end.poll_feedback(now_ns)) is not None:
            self._ask(feedback, now_ns)
        self._timer.set(end.poll_timeout(), now_ns)

    def _decode(self, unit: ReceivedUnit, now_ns: int) -> None:
        if self.on_unit is not None:
            self.on_unit(unit)
        self._waiting = self._waiting or []
        shown_ns = now_ns + self._cost_ns
        job = self._decoder.submit((unit.data, unit.timestamp, shown_ns))
        self._agenda.at(shown_ns, partial(self._finish, job))

    def _finish(self, job: Job, now_ns: int) -> None:
        pictures, counts, lights, quality = job.result()
        self.quality_db.extend(quality)
        for stamp in self.end.handle_decoded(pictures, counts):
            if stamp is not None and stamp.rtp_timestamp is not None:
                self._recall.add(stamp.rtp_timestamp, stamp.capture_ns)
                self._display.handle_shown(self._stream, stamp, now_ns)
                for call in self.on_shown:
                    call(now_ns, now_ns - stamp.capture_ns)
        for light in lights:
            publish_light(self._display.probe, self._stream, light, self._recall.captured_ns)
        if (unit := self.end.next_unit()) is not None:
            self._decode(unit, now_ns)
            return
        waiting, self._waiting = self._waiting, None
        # Reports are first, because the first of them dates the first picture.
        for take, datagram in sorted(
            waiting or (), key=lambda each: each[0] != self.end.handle_report
        ):
            take(datagram, now_ns)
        self._step(now_ns)


class VoiceReceiveProcess:
    """Plays each block of sound at its instant."""

    def __init__(self, scene: Scene, stream: VoiceStream, display: Display) -> None:
        self._receiver = receiver = voice_receiver(
            scene.topology, stream, wall_offset_ns=WALL_OFFSET_NS
        )
        self._stream, self._display = stream.name, display
        self._probe = probe = scene.telling.probe(scene.topology.media(stream.name).receiver)
        make = partial(VoiceDecoding, watched=stream.name in OPERATORS)
        self._decoder, self._recall = scene.workers.start(make), Recall()
        self._agenda = scene.agenda
        self._timer = Timer(scene.agenda, self._drain)
        scene.telling.add(lambda: probe.publish(receiver.counts))
        self._cost_ns = scene.costs.ns("voice_decode")
        self.handle_picture_shown = receiver.handle_picture_shown

    def handle_packet(self, datagram: bytes, now_ns: int) -> None:
        self._receiver.handle_packet(datagram, now_ns)
        self._drain(now_ns)

    def handle_report(self, datagram: bytes, now_ns: int) -> None:
        self._receiver.handle_report(datagram, now_ns)
        self._drain(now_ns)

    def _drain(self, now_ns: int) -> None:
        note_arrivals(self._probe, self._receiver)
        self._receiver.handle_timeout(now_ns)
        while (block := self._receiver.next_event()) is not None:
            heard_ns = now_ns + self._cost_ns
            job = self._decoder.submit((block, heard_ns))
            capture_ns = self._receiver.capture_ns(block.timestamp)
            self._agenda.at(heard_ns, partial(self._play, job, block, capture_ns))
        self._timer.set(self._receiver.poll_timeout(), now_ns)

    def _play(self, job: Job, block: PlayoutBlock, capture_ns: int | None, now_ns: int) -> None:
        decoded, clicks = job.result()
        stamp = self._receiver.handle_sound(block, decoded=decoded, capture_ns=capture_ns)
        if stamp is not None:
            self._display.handle_shown(self._stream, stamp, now_ns)
            self._recall.add(block.timestamp, stamp.capture_ns)
        for click in clicks:
            publish_click(self._display.probe, self._stream, click, self._recall.captured_ns)
