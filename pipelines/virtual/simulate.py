"""Whole sessions on virtual time, from their setups or recordings to their reports.

Of a recorded session what was sent then is sent again. Access units and Opus packets keep their
octets, and come to their senders the fixed time of coding after their capture. Haptic samples and
space packets go at the instants at which they were sent. From there on all is as in any simulation.
What arrives changes nothing of what is sent: neither force nor position, no acknowledgement and no
key picture that a receiver asks for.
"""

import gc
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial

import msgspec
import numpy as np

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ConfigError
from kontur_av.media import BLOCK_NS, AccessUnit, CaptureStamp
from kontur_av.rtp.annex_b import join_annex_b, split_annex_b
from kontur_av.rtp.nal_depacketizer import ReceivedUnit
from pipelines.hand.replaying import ReplayedEnd, ReplayScript, ReplayTime
from pipelines.media.following import Choice
from pipelines.media.media_metrics import CodingCosts
from pipelines.media.stream_metrics import video_sender
from pipelines.recording.recorded_messages import SAMPLE
from pipelines.recording.recorded_session import RecordedSession, SentPacket, SentUnit
from pipelines.recording.recorder_metrics import ReplayMetrics
from pipelines.report.model import ReplayedStream, ReplayReport, SessionReport
from pipelines.session.setup.table import Setup, VideoStream, VoiceStream
from pipelines.session.topology.streams import TELECOMMAND, TELEMETRY
from pipelines.virtual.media import Camera, Media
from pipelines.virtual.session import HapticEnd, Selection, Simulation
from pipelines.virtual.streams import Consumer, VideoReceiveProcess, VideoSendProcess, VoiceProcess
from pipelines.virtual.studio import SAME_DB, Originals, VideoDecoding, VideoStudio
from pipelines.virtual.workers import WALL_OFFSET_NS, Coder, Scene, Timer, Workers
from telepresence.haptics.device.device import JoystickDevice
from telepresence.haptics.robot import Robot
from telepresence.tasks.definitions import Catalogue
from telepresence.tasks.plan import SessionPlan

#: The link begins this and two round trips before the first instant, so that it is connected then.
_LEAD_NS = 300 * NS_PER_MS
#: It ends this long after the last instant and the radio's delay: coding, queueing and playout. A
#: longer time would count as a frozen picture.
_TAIL_NS = 150 * NS_PER_MS


class Replay(Simulation):
    """`session` on the link of `setup`.

    The radio's time is that of the recorded session. If its start is not known, the radio's time 0
    is the first thing that was sent. end_ns: when everything has arrived.

    recode: with the path of the recording, its pictures are coded anew, by the session's encoder.
    Raises ConfigError for a stream of the setup that is not in the recording, and for a recording
    in several parts that is to be coded anew.
    """

    _recorded = True

    def __init__(
        self,
        session: RecordedSession,
        setup: Setup,
        workers: Workers,
        *,
        seed: int,
        media: bool = True,
        costs: CodingCosts | None = None,
        recode: str | None = None,
    ) -> None:
        if recode is not None and session.parts > 1:
            raise ConfigError(
                f"--recode on virtual time takes one part, and {recode} has {session.parts}: "
                "`kontur-av replay --recode` takes them all"
            )
        self._session, self._recode = session, recode
        self._ends: list[ReplayedEnd] = []
        first_ns, last_ns = session.instants_ns
        longest_ns = setup.radio_profile.longest_delay_ns
        # Whole milliseconds, so that samples keep their place between two slots.
        lead_ns = (_LEAD_NS + 4 * longest_ns) // NS_PER_MS * NS_PER_MS
        began_ns = (session.metadata.started_ns or first_ns) // NS_PER_MS * NS_PER_MS
        self.time = ReplayTime(recorded_ns=began_ns, replayed_ns=lead_ns)
        first_ns, last_ns = self.time.at(first_ns), self.time.at(last_ns)
        start_ns = max(0, first_ns - lead_ns) // NS_PER_MS * NS_PER_MS
        self.end_ns = last_ns + longest_ns + _TAIL_NS
        super().__init__(
            setup, workers, seed=seed, media=media, costs=costs, start_ns=start_ns, epoch_ns=lead_ns
        )
        for stream, gateway in ((TELECOMMAND, self._space), (TELEMETRY, self._ground)):
            packets = session.packets.get(stream, ())
            sender = self.topology.stream(stream).sender
            assert sender is not None
            send = partial(_send_packet, packets, partial(gateway.handle_datagram, stream))
            follow(self._scene, sender, packets, self.time, 0, send)

    def report(self) -> SessionReport:
        """The report of a simulation, and what became of the recorded streams."""
        # First, because it waits for the pictures that are still being decoded.
        report = super().report()
        media = self._media
        replay = ReplayReport(
            session=self._session.metadata.session,
            recorded_seed=self._session.metadata.seed,
            speed=1.0,
            recoded=self._recode is not None,
            streams=media.streams_report() if isinstance(media, ReplayedMedia) else {},
            samples_superseded=sum(end.superseded for end in self._ends),
            missing=self._session.missing,
        )
        return msgspec.structs.replace(report, replay=replay)

    def _make_ends(self) -> tuple[HapticEnd, HapticEnd]:
        up, down = self.topology.haptic("up"), self.topology.haptic("down")
        self._ends = [
            ReplayedEnd(
                self._session.haptics.get(row.key, np.empty(0, SAMPLE)),
                self.time,
                self._probe(row.sender),
                robot=row is up,
                boot_id=self._boot_id(row.sender),
            )
            for row in (up, down)
        ]
        robot, joystick = self._ends
        return robot, joystick

    def _make_media(self, scene: Scene) -> Media:
        return ReplayedMedia(scene, self._confirm, self._session, self.time, self._recode)

    def _follow(self, choice: Choice, now_ns: int) -> None:
        """Confirm at once. The pictures are those of the recording, whatever is selected."""
        self._confirm(choice.number, now_ns)


def _send_packet(
    packets: Sequence[SentPacket], send: Consumer, number: int, _: int, now_ns: int
) -> None:
    send(packets[number].data, now_ns)


def follow(
    scene: Scene,
    process: str,
    items: Sequence[SentUnit] | Sequence[SentPacket],
    time: ReplayTime,
    cost_ns: int,
    send: Callable[[int, int, int], None],
) -> None:
    """Have each item of a process sent: its number, its instant in the replay, and now."""
    script = ReplayScript([item[0] for item in items], time, cost_ns=cost_ns, now_ns=scene.start_ns)
    scene.telling.probe(process).publish(ReplayMetrics(items_left_out=script.left_out))

    def work(now_ns: int) -> None:
        while (due := script.poll_due(now_ns)) is not None:
            send(*due, now_ns)
        timer.set(script.poll_timeout(), now_ns)

    timer = Timer(scene.agenda, work)
    timer.set(script.poll_timeout(), scene.start_ns)


class ReplayedMedia(Media):
    """The streams of a setup; what a recording has of them is sent."""

    def __init__(
        self,
        scene: Scene,
        on_confirmed: Callable[[int, int], None],
        session: RecordedSession,
        time: ReplayTime,
        recode: str | None,
    ) -> None:
        self._session, self._time, self._recode = session, time, recode
        self._tallies: dict[str, _Tally] = {}
        super().__init__(scene, on_confirmed)
        for name, receiver in self.video_receivers.items():
            self._tallies[name] = tally = _Tally(
                self._session.pictures.get(name, []), session.received.get(name), receiver
            )
            receiver.on_unit = tally.handle_unit

    def streams_report(self) -> dict[str, ReplayedStream]:
        return {name: tally.report() for name, tally in self._tallies.items()}

    def _send_uplink_video(self) -> None:
        self._send_downlink_video(self._scene.setup.uplink_video)

    def _send_downlink_video(self, stream: VideoStream) -> None:
        scene, units = self._scene, self._session.pictures.get(stream.name)
        if not units:
            return
        if self._recode is not None:
            camera = scene.topology.media(stream.name).inputs[0]
            films = {camera: f"mcap:{self._recode}#/{stream.name}/sent"}
            first_ns = self._time.at(units[0].capture_ns)
            studio = scene.workers.start(partial(VideoStudio, stream, films, first_ns))
            sender = self._add_sender(stream, VideoSendProcess(scene, stream, studio))
            Camera(scene, camera, stream.fps, studio, sender.handle_picture)
            return
        sender = self._add_sender(stream, VideoSendProcess(scene, stream))
        cost_ns = scene.costs.ns("capture") + scene.costs.picture_ns("encode", stream.codec)
        self._feed(stream.name, units, cost_ns, sender)

    def _send_voice(self, stream: VoiceStream, name: str) -> None:
        scene, units = self._scene, self._session.voices.get(stream.name)
        if not units:
            return
        cost_ns = BLOCK_NS + scene.costs.ns("voice_encode")
        sender = VoiceProcess(scene, stream)
        self._add_voice(stream, sender)
        self._feed(stream.name, units, cost_ns, sender)

    def _feed(
        self,
        name: str,
        units: Sequence[SentUnit],
        cost_ns: int,
        sender: VideoSendProcess | VoiceProcess,
    ) -> None:

        def send(number: int, capture_ns: int, now_ns: int) -> None:
            unit, stamp = units[number], CaptureStamp(capture_ns, number, name)
            sender.handle_coded(AccessUnit(unit.data, stamp, unit.key, unit.codec), now_ns)

        process = self._scene.topology.media(name).sender
        follow(self._scene, process, units, self._time, cost_ns, send)

    def _decoding(
        self, stream: VideoStream, watched: tuple[int, int] | None
    ) -> Callable[[], Coder]:
        scene, units = self._scene, self._session.pictures.get(stream.name, [])
        identity = scene.identity(stream.name)
        core = video_sender(scene.setup, stream, identity, wall_offset_ns=WALL_OFFSET_NS)
        dated = [(core.timestamp(self._time.at(unit.capture_ns)), unit.data) for unit in units]
        # Recoded units may have another codec than the stream.
        codec = units[0].codec if units else stream.codec
        originals = Originals(dated, (stream.width, stream.height), codec)
        return lambda: VideoDecoding(watched, originals, codec=stream.codec)


class _Tally:
    """Compares the access units that came with those that were sent, then and in the recording.

    recorded: those that came in the recorded session; None: not known.
    """

    def __init__(
        self, sent: Sequence[SentUnit], recorded: list[bytes] | None, receiver: VideoReceiveProcess
    ) -> None:
        self._sent = len(sent)
        self._whole = Counter(_normal(unit.data) for unit in sent)
        self._recorded = None if recorded is None else Counter(map(_normal, recorded))
        self._came: Counter[bytes] = Counter()
        self._receiver = receiver

    def handle_unit(self, unit: ReceivedUnit) -> None:
        self._came[_normal(unit.data)] += 1

    def report(self) -> ReplayedStream:
        quality = np.array(self._receiver.quality_db)
        recorded = self._recorded
        known = len(quality) > 0
        return ReplayedStream(
            units_recorded=self._sent,
            units_received=(self._came & self._whole).total(),
            recorded_received=None if recorded is None else (recorded & self._whole).total(),
            same_received=None if recorded is None else (recorded & self._came).total(),
            pictures_same=int((quality >= SAME_DB).sum()),
            psnr_db_mean=round(float(quality.mean()), 2) if known else None,
            psnr_db_p5=round(float(np.percentile(quality, 5)), 2) if known else None,
        )


def _normal(data: bytes) -> bytes:
    """With start codes of four octets, as a receiver writes them."""
    return join_annex_b(split_annex_b(data))


#: The virtual time between two checks whether to stop.
_STRIDE_NS = 50 * NS_PER_MS


def simulate(
    setup: Setup,
    *,
    seconds: float,
    seed: int,
    media: bool = True,
    selections: Sequence[Selection] = (),
    costs: CodingCosts | None = None,
    stopped: Callable[[], bool] = lambda: False,
    plan: tuple[SessionPlan, Catalogue] | None = None,
    robot: Robot | None = None,
    joystick: JoystickDevice | None = None,
) -> SessionReport:
    """Simulate `seconds` of virtual time. The same arguments give the same report.

    plan: of `telepresence.tasks.task_files.load_plan`; None: the hand taps targets all the time.
    robot, joystick: as of `Simulation`.

    stopped: called again and again; True ends the simulation early.
    """
    with Workers() as workers:
        simulation = Simulation(
            setup,
            workers,
            seed=seed,
            media=media,
            selections=selections,
            costs=costs,
            plan=plan,
            robot=robot,
            joystick=joystick,
        )
        _run(simulation, round(seconds * NS_PER_S), stopped)
        return simulation.report()


def replay(
    session: RecordedSession,
    setup: Setup,
    *,
    seed: int,
    seconds: float | None = None,
    media: bool = True,
    costs: CodingCosts | None = None,
    recode: str | None = None,
    stopped: Callable[[], bool] = lambda: False,
) -> SessionReport:
    """Send a recorded session through the link of `setup` on virtual time.

    seconds: of virtual time; None: until everything has arrived. recode, seed, media, costs: as of
    `Replay`. stopped: as of `simulate`.
    """
    with Workers() as workers:
        simulation = Replay(
            session, setup, workers, seed=seed, media=media, costs=costs, recode=recode
        )
        end_ns = simulation.end_ns
        if seconds is not None:
            end_ns = min(end_ns, simulation.start_ns + round(seconds * NS_PER_S))
        _run(simulation, end_ns, stopped)
        return simulation.report()


def _run(simulation: Simulation, end_ns: int, stopped: Callable[[], bool]) -> None:
    # The present objects stay until the end, so the garbage collector need not visit them. It
    # need not look for garbage among them first, either.
    gc.freeze()
    try:
        now_ns = simulation.start_ns
        while now_ns < end_ns and not stopped():
            now_ns = min(now_ns + _STRIDE_NS, end_ns)
            simulation.run(now_ns)
        simulation.close()
    finally:
        gc.unfreeze()
