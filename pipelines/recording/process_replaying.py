"""The processes of a replayed session: each sends again what it sent in the recorded one."""

import secrets
import select
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.codecs.decoder import VideoDecoder
from kontur_av.media import BLOCK_NS, AccessUnit, CaptureStamp
from kontur_av.rtp.sender import RtpIdentity
from kontur_av.sources.fit import Fitter, scaled_aspect
from pipelines.hand.haptic_loop import new_boot_id, run_loop, session_ports
from pipelines.hand.replaying import ReplayedEnd, ReplayScript, ReplayTime
from pipelines.media.media_metrics import CodingCosts
from pipelines.media.process_send import VideoOutlet, to_gateway
from pipelines.media.stream_metrics import Outgoing, publish_sender, voice_sender
from pipelines.media.taking_over import Capturing
from pipelines.mission.choosing import CameraChoice
from pipelines.mission.supervisor import session_dictionary
from pipelines.mission.tmtc import TmtcEnd
from pipelines.mission.tmtc_messages import FunctionAsked
from pipelines.recording.recorded_messages import SAMPLE
from pipelines.recording.recorded_session import RecordedSession, SentPacket, SentUnit
from pipelines.recording.recorder_metrics import ReplayMetrics
from pipelines.recording.rows import Script, replay_topology
from pipelines.session.datagrams import receive
from pipelines.session.process import Context, wait_ns
from pipelines.session.setup.segments import Segment
from pipelines.session.setup.table import VideoStream, VoiceStream
from pipelines.session.topology.streams import TELECOMMAND, TELEMETRY
from pipelines.session.topology.table import Topology
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary

#: From capture to encoder, and to sender: as in a simulation.
_COSTS = CodingCosts()


@dataclass(frozen=True, kw_only=True)
class ReplayStart:
    """What was sent at `recorded_ns` is sent `lead_ns` after the start of the replay.

    speed: seconds of the recording a second.
    """

    recorded_ns: int
    lead_ns: int
    speed: float

    def time_of(self, context: Context) -> ReplayTime:
        # Whole milliseconds, so that samples keep their place between two slots.
        begin_ns = (context.started_ns + self.lead_ns) // NS_PER_MS * NS_PER_MS
        return ReplayTime(
            recorded_ns=self.recorded_ns // NS_PER_MS * NS_PER_MS,
            replayed_ns=begin_ns,
            speed=self.speed,
        )

    def script(
        self, context: Context, items: Sequence[SentUnit] | Sequence[SentPacket], cost_ns: int
    ) -> ReplayScript:
        """When a process that starts now sends `items`, `cost_ns` after their instants."""
        script = ReplayScript(
            [item[0] for item in items],
            self.time_of(context),
            cost_ns=cost_ns,
            now_ns=context.clock.now_ns(),
        )
        context.probe.publish(ReplayMetrics(items_left_out=script.left_out))
        return script


def run_video_replay(
    context: Context, *, stream: VideoStream, units: Sequence[SentUnit], start: ReplayStart
) -> None:
    """Send the recorded access units of a stream."""
    clock = context.clock
    cost_ns = _COSTS.ns("capture") + _COSTS.picture_ns("encode", stream.codec)
    script = start.script(context, units, cost_ns)
    decoder = VideoDecoder(stream.codec, size=(stream.width, stream.height))
    with context.open_bus() as bus:
        outlet = VideoOutlet(context, bus, stream)
        end = outlet.end
        waiter = bus.waiter([outlet.backlogs.open()], [outlet.feedback.fileno()])
        while not context.stopping:
            now_ns = clock.now_ns()
            context.tick(now_ns)
            waiter.wait(wait_ns(now_ns, script.poll_timeout(), end.poll_timeout(now_ns)))
            while (due := script.poll_due(clock.now_ns())) is not None:
                number, capture_ns = due
                stamp = CaptureStamp(capture_ns, number, stream.name)
                recorded = units[number]
                unit = AccessUnit(recorded.data, stamp, recorded.key, recorded.codec)
                end.handle_coded(unit, clock.now_ns())
                # Nothing is filmed, so a reader that joins begins with what is decoded here.
                shown, size = None, stream.coded_size
                for shown in decoder.decode(unit.data, number) if unit.codec == "h264" else ():
                    size = shown.width, shown.height
                outlet.sent.handle_unit(unit, size, shown)
            outlet.work()
        end.close(clock.now_ns())
        del waiter


def run_recoded_camera(
    context: Context,
    *,
    name: str,
    stream: VideoStream,
    units: Sequence[SentUnit],
    start: ReplayStart,
) -> None:
    """Be the camera `name`: show the recorded pictures of `stream`, which its sender codes anew."""
    clock, size = context.clock, (stream.width, stream.height)
    decoder = VideoDecoder(units[0].codec if units else "h264")
    fitter, capturing = Fitter(*size), Capturing(context.probe)
    context.on_flush(capturing.publish)
    script = start.script(context, units, _COSTS.ns("capture"))
    with context.open_bus() as bus:
        writer = bus.writer(
            context.topology.input(name).topic, max_octets=stream.width * stream.height * 3 // 2
        )
        while not context.stopping:
            now_ns = clock.now_ns()
            context.tick(now_ns)
            clock.sleep_until_ns(now_ns + wait_ns(now_ns, script.poll_timeout()))
            while (due := script.poll_due(clock.now_ns())) is not None:
                number, capture_ns = due
                stamp = CaptureStamp(capture_ns, number, name)
                for picture in decoder.decode(units[number].data, number):
                    frame = picture.frame
                    aspect = scaled_aspect(*size, frame.width, frame.height)
                    loan = writer.loan_picture(*size)
                    fitter.write(fitter.scale(frame, aspect), loan.picture)
                    loan.publish(stamp)
                    capturing.handle_captured(stamp)


def run_voice_replay(
    context: Context, *, stream: VoiceStream, units: Sequence[SentUnit], start: ReplayStart
) -> None:
    """Send the recorded Opus packets of a stream."""
    clock = context.clock
    identity = RtpIdentity.draw(secrets.randbits)
    sender = voice_sender(context.setup, stream, identity, wall_offset_ns=clock.wall_offset_ns)
    outgoing = Outgoing(sender, context.probe, *to_gateway(context, stream.name))
    context.on_flush(lambda: publish_sender(context.probe, sender))
    script = start.script(context, units, BLOCK_NS + _COSTS.ns("voice_encode"))
    while not context.stopping:
        now_ns = clock.now_ns()
        context.tick(now_ns)
        clock.sleep_until_ns(now_ns + wait_ns(now_ns, script.poll_timeout(), sender.poll_timeout()))
        while (due := script.poll_due(clock.now_ns())) is not None:
            number, capture_ns = due
            stamp = CaptureStamp(capture_ns, number, stream.name)
            if sender.handle_block(stamp, clock.now_ns()):
                sender.handle_packet(units[number].data, stamp, clock.now_ns())
        outgoing.handle_time(clock.now_ns())
    outgoing.close(clock.now_ns())


def run_telecommands_replay(
    context: Context, *, packets: Sequence[SentPacket], start: ReplayStart
) -> None:
    """Send the recorded telecommands, and count the telemetry that comes."""
    take = _listener(context, Segment.SPACE, None)
    _run_packets(context, TELECOMMAND, TELEMETRY, packets, start, take)


def run_telemetry_replay(
    context: Context, *, packets: Sequence[SentPacket], start: ReplayStart
) -> None:
    """Send the recorded telemetry, and count the telecommands that come.

    Selections of a camera are confirmed at once: the pictures are those of the recording.
    """
    now_ns = context.clock.now_ns()
    choice = CameraChoice(context.setup.cameras, context.probe, now_ns=now_ns)
    context.on_flush(choice.publish)
    take = _listener(context, Segment.GROUND, choice)
    _run_packets(context, TELEMETRY, TELECOMMAND, packets, start, take)


def _listener(
    context: Context, segment: Segment, choice: CameraChoice | None
) -> Callable[[bytes, int], None]:
    """A TM/TC end that takes packets, and sends none. choice: carries out selections."""
    end = TmtcEnd(
        segment,
        session_dictionary(built_in_dictionary(), context.topology),
        now_ns=context.clock.now_ns(),
        first_count=0,
        boot_id=0,
    )
    context.on_flush(lambda: end.publish(context.probe))

    def drain(now_ns: int) -> None:
        while end.poll_transmit(now_ns) is not None:
            pass  # what it would send is in the recording

    def take(datagram: bytes, now_ns: int) -> None:
        end.handle_packet(datagram, now_ns)
        drain(now_ns)
        while (news := end.next_event()) is not None:
            if choice is None or not isinstance(news, FunctionAsked):
                continue
            choice.handle_asked(news, now_ns)
            if (chosen := choice.poll_choice(now_ns)) is not None:
                choice.handle_confirmed(chosen.number)
            while (done := choice.next_event()) is not None:
                end.handle_request(done, now_ns)
        drain(now_ns)

    return take


def _run_packets(
    context: Context,
    outgoing: str,
    incoming: str,
    packets: Sequence[SentPacket],
    start: ReplayStart,
    take: Callable[[bytes, int], object],
) -> None:
    clock, topology = context.clock, context.topology
    udp = context.listen_own(topology.exit_port(incoming))
    send = context.own_sender(topology.entry_port(outgoing))
    script = start.script(context, packets, 0)
    while not context.stopping:
        now_ns = clock.now_ns()
        context.tick(now_ns)
        select.select([udp], [], [], wait_ns(now_ns, script.poll_timeout()) / NS_PER_S)
        while (due := script.poll_due(clock.now_ns())) is not None:
            send(packets[due[0]].data)
        while (datagram := receive(udp)) is not None:
            take(datagram, clock.now_ns())


def run_haptic_replay(
    context: Context, *, rows: NDArray[np.void], robot: bool, start: ReplayStart
) -> None:
    """Send the recorded samples of an end, in a loop at 1 kHz."""
    time = start.time_of(context)
    end = ReplayedEnd(rows, time, context.probe, robot=robot, boot_id=new_boot_id())
    port, gateway_port = session_ports(context.topology, "robot" if robot else "joystick")
    run_loop(context, end, port, context.own_sender(gateway_port))


def replayed_session(
    plain: Topology, recorded: RecordedSession, start: ReplayStart, *, recode: bool
) -> Topology:
    """The session in which each process sends again what it sent in the recorded one."""
    scripts: dict[str, Script] = {}
    recoded: dict[str, Script] = {}

    def script(run: str, **arguments: object) -> Script:
        return Script(f"{__name__}:{run}", {**arguments, "start": start})

    for media in plain.media_streams:
        stream, name = media.stream, media.name
        if isinstance(stream, VoiceStream):
            units = recorded.voices.get(name, [])
            scripts[media.sender] = script("run_voice_replay", stream=stream, units=units)
            continue
        units = recorded.pictures.get(name, [])
        if recode:
            camera = media.inputs[0]
            recoded[name] = script("run_recoded_camera", name=camera, stream=stream, units=units)
        else:
            scripts[media.sender] = script("run_video_replay", stream=stream, units=units)
    for key, robot in (("up", True), ("down", False)):
        rows = recorded.haptics.get(key, np.empty(0, SAMPLE))
        sender = plain.haptic(key).sender
        scripts[sender] = script("run_haptic_replay", rows=rows, robot=robot)
    for packets, run in (
        (TELECOMMAND, "run_telecommands_replay"),
        (TELEMETRY, "run_telemetry_replay"),
    ):
        process = plain.stream(packets).sender
        assert process is not None
        scripts[process] = script(run, packets=recorded.packets.get(packets, []))
    # The radio's time 0 is the start of the recorded session, or else the first thing sent.
    began_ns = recorded.metadata.started_ns or start.recorded_ns
    before_ns = round((start.recorded_ns - began_ns) / start.speed)
    return replay_topology(plain, scripts, recoded, radio_after_ns=start.lead_ns - before_ns)
