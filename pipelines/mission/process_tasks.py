"""The process of experiment and TOP kernel on the ground. `MissionGround` decides.

Each run of a task may have a recording of its own, made by the session's recorder. Killing the
process leaves the robot controller running. Its next start ends the run as aborted, and
switches the robot off.
"""

import queue
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import msgspec

from kontur_av.clock import NS_PER_MS
from kontur_av.errors import ConfigError
from kontur_av.topics.bus import TopicBus
from kontur_av.topics.session_files import make_session_root, remember, session_root
from pipelines.link.link_metrics import CONNECTED, link_state_topic
from pipelines.media.following import SELECTED_TOPIC
from pipelines.mission.mission import MissionGround, MissionMemory, Seen, TaskOptions, robot_order
from pipelines.mission.mission_metrics import TaskMetrics
from pipelines.mission.tmtc_messages import FunctionAsked
from pipelines.mission.tmtc_socket import TmtcClient
from pipelines.session.datagrams import LOOPBACK, receive
from pipelines.session.mission_messages import (
    MISSION_CAMERA_TOPIC,
    MISSION_GROUND_TOPIC,
    ROBOT_ORDER_TOPIC,
    ROBOT_STATUS_TOPIC,
    SECOND_ROBOT_TOPIC,
    CameraRequest,
    RobotStatus,
)
from pipelines.session.process import Context
from pipelines.session.recording_requests import (
    RECORDER_S,
    RECORDER_SOCKET,
    RETURN_S,
    AskRecording,
    RecordAnswer,
    RecordingOptions,
    RecordRequest,
    StartRecording,
    StopRecording,
)
from pipelines.session.requests import ask
from pipelines.session.setup.segments import Segment
from pipelines.session.task_journal import KEPT, LinkMeanwhile
from pipelines.session.topic_ends import TopicReader, TopicWriter
from pipelines.session.topology.streams import leds_port
from pipelines.session.topology.topics import TASKS
from pipelines.session.training import TRAINER_TOPIC
from telepresence.malformed import MALFORMED
from telepresence.tasks.definitions import ControlMode
from telepresence.tasks.kernel import TICK_NS, ChooseCamera, OtherHand, Record
from telepresence.tasks.panel_picture import ACKNOWLEDGEMENT_OCTETS
from telepresence.tasks.task_files import built_in_tasks
from telepresence.world import WorldState

#: A robot that is silent for longer has a fault.
_SILENT_NS = 500 * NS_PER_MS
#: Between two ticks messages and datagrams are handled.
_STEP_NS = 20 * NS_PER_MS
_PUBLISH_EVERY = 10
_OFF = RobotStatus(
    boot_id=0, powered=False, mode=ControlMode.POSITION, x_m=0.0, y_m=0.0, push_n=0.0
)


def run_tasks(context: Context, options: TaskOptions | None = None) -> None:
    """Execute tasks. options: None: the built-in ones, which people select."""
    with context.open_bus() as bus:
        _Tasks(context, bus, options or TaskOptions(catalogue=built_in_tasks())).run()


class _Tasks:
    """The process's shell."""

    def __init__(self, context: Context, bus: TopicBus, options: TaskOptions) -> None:
        self._context, self._clock = context, context.clock
        now_ns = self._clock.now_ns()
        make_session_root(context.session)
        self._remembered = session_root(context.session) / "tasks"
        self._kept = _read(self._remembered)
        self._ground = MissionGround(
            options.catalogue,
            options.plan,
            now_ns=now_ns,
            memory=self._kept,
            first_number=now_ns // (100 * NS_PER_MS) % (1 << 32),
            world=options.world,
        )
        if self._kept is None and self._remembered.exists():
            self._ground.switch_off(now_ns)
        two_hands = options.world.two_hands
        self._other_robot = TopicReader(bus, SECOND_ROBOT_TOPIC) if two_hands else None
        self._other: WorldState | None = None
        self._client = TmtcClient(bus, context.session, Segment.GROUND, TASKS, first_number=now_ns)
        self._status = TopicReader(bus, ROBOT_STATUS_TOPIC)
        self._selected = TopicReader(bus, SELECTED_TOPIC)
        self._links = TopicReader(bus, link_state_topic(Segment.GROUND))
        trained = TRAINER_TOPIC in context.topology.reads(TASKS)
        self._exercises = TopicReader(bus, TRAINER_TOPIC) if trained else None
        self._orders = TopicWriter(bus, ROBOT_ORDER_TOPIC)
        self._cameras = TopicWriter(bus, MISSION_CAMERA_TOPIC)
        self._shown = TopicWriter(bus, MISSION_GROUND_TOPIC, wake=True)
        self._udp = context.listen(0)
        self._leds = options.leds or (LOOPBACK, leds_port(context.setup))
        self._files = RunFiles(context.session, options.runs)
        self._number = now_ns
        self._camera, self._signal, self._boot_id = "", False, 0
        self._link = LinkMeanwhile(0, 0, context.setup.radio_profile.longest_delay_ns)
        context.on_flush(self._publish)

    def run(self) -> None:
        """Work until the process shall end."""
        tick_ns, ticks = self._clock.now_ns(), 0
        while not self._context.stopping:
            now_ns = self._clock.now_ns()
            self._listen(now_ns)
            if now_ns >= tick_ns:
                tick_ns = max(tick_ns + TICK_NS, now_ns)
                self._ground.handle_tick(self._seen(now_ns), now_ns)
                if ticks % 2 == 0:
                    self._shown.publish(self._ground.shown, now_ns)
                if ticks % _PUBLISH_EVERY == 0:
                    self._client.publish(self._ground.telemetry)
                ticks += 1
            self._carry_out(now_ns)
            self._context.tick(now_ns)
            self._clock.sleep_until_ns(min(tick_ns, now_ns + _STEP_NS))
        self._files.close()

    def _listen(self, now_ns: int) -> None:
        for came in self._client.work(now_ns):
            if isinstance(came, FunctionAsked):
                refusal = self._ground.handle_function(came.function, came.arguments, now_ns)
                self._client.answer(came, refusal)
            else:
                self._ground.handle_message(came, now_ns)
        while (octets := receive(self._udp, ACKNOWLEDGEMENT_OCTETS + 1)) is not None:
            self._ground.leds.handle_datagram(octets, now_ns)
        if self._exercises is not None:
            self._exercises.latest()
        if (choice := self._selected.latest()) is not None:
            self._camera = choice.camera
        if (values := self._links.latest()) is not None:
            self._signal = values.get("state") == CONNECTED
            frames, lost = values.get("frames", 0), values.get("frames_lost", 0)
            self._link = self._link._replace(frames=int(frames), frames_lost=int(lost))

    def _seen(self, now_ns: int) -> Seen:
        self._status.latest()
        robot = self._status.newest or _OFF
        if now_ns - self._status.newest_ns > _SILENT_NS:
            robot = msgspec.structs.replace(robot, fault=robot.fault or "it does not answer")
        elif self._boot_id and robot.boot_id != self._boot_id:
            robot = msgspec.structs.replace(robot, fault=robot.fault or "it was restarted")
        self._boot_id = robot.boot_id
        exercises = None if self._exercises is None else self._exercises.newest
        return Seen(
            robot=robot,
            camera=self._camera,
            recording=self._files.recording,
            signal=self._signal,
            link=self._link,
            other=self._other_hand(now_ns),
            exercise=exercises is not None and now_ns < exercises.tasks_ns,
        )

    def _other_hand(self, now_ns: int) -> OtherHand | None:
        if self._other_robot is None:
            return None
        self._other_robot.latest()
        other = self._other_robot.newest
        if other is None or now_ns - other.time_ns > _SILENT_NS:
            return None
        return OtherHand(x_m=other.x_m, y_m=other.y_m, push_n=other.force_n, holds=other.holds)

    def _carry_out(self, now_ns: int) -> None:
        ground = self._ground
        memory = ground.memory
        if memory != self._kept:
            # Before anything follows from it.
            self._kept = memory
            remember(self._remembered, msgspec.json.encode(memory))
        while (order := ground.poll_order()) is not None:
            self._number = max(now_ns, self._number + 1)
            if isinstance(order, ChooseCamera):
                self._cameras.publish(CameraRequest(self._number, order.name), now_ns)
            elif isinstance(order, Record):
                status = ground.experiment.status
                self._files.record(on=order.on, task=status.task, run=status.run)
            elif (told := robot_order(order, self._number)) is not None:
                self._orders.publish(told, now_ns)
        while (message := ground.poll_message()) is not None:
            self._client.send(message, now_ns)
        while (octets := ground.leds.poll_transmit(now_ns)) is not None:
            with suppress(OSError):
                self._udp.sendto(octets, self._leds)

    def _publish(self) -> None:
        rows, files, probe = self._ground.journal.newest(KEPT), self._files, self._context.probe
        runs = {row.run: row for row in rows}
        why = files.why or None
        probe.publish(TaskMetrics(unrecorded=files.unrecorded, unrecorded_why=why, runs=runs))


def _read(path: Path) -> MissionMemory | None:
    try:
        return msgspec.json.decode(path.read_bytes(), type=MissionMemory)
    except (OSError, *MALFORMED):
        return None


#: So much longer than the run its file lasts.
_TAIL_S = 1.0


class RunFiles:
    """Asks the recorder in a thread, because it may take seconds to end a file.

    directory: of the files, `run-003-aiming.mcap`; None: no files, and `recording` is what was
    asked for. What an earlier start has left open is ended. Recordings of others are left alone.

    recording: whether a run is recorded. unrecorded: runs without a file; why: of the newest one.
    """

    def __init__(self, session: str, directory: str | None) -> None:
        self.recording = False
        self.unrecorded, self.why = 0, ""
        self._session = session
        self._directory = None if directory is None else Path(directory)
        self._asked: queue.Queue[Callable[[], None] | None] = queue.Queue()
        self._wanted = self._closing = False
        self._thread: threading.Thread | None = None
        if directory is not None:
            self._thread = threading.Thread(target=self._work, daemon=True)
            self._thread.start()
            self._asked.put(self._end)

    def record(self, *, on: bool, task: str, run: int) -> None:
        """Begin or end the file of a run. The same again changes nothing."""
        if on is self._wanted:
            return
        self._wanted = on
        if self._directory is None:
            self.recording = on
        elif on:
            file = self._directory / f"run-{run:03d}-{task}.mcap"
            options = RecordingOptions(file=str(file), command=f"task {task}, run {run}")
            self._asked.put(lambda: self._begin(options))
        else:
            self._asked.put(self._end)

    def close(self) -> None:
        """End what is being recorded. With the session, the recorder ends it, too."""
        self._closing = True
        if self._thread is not None:
            self.record(on=False, task="", run=0)
            self._asked.put(None)
            self._thread.join(3.0)

    def _work(self) -> None:
        while (work := self._asked.get()) is not None:
            work()

    def _begin(self, options: RecordingOptions) -> None:
        try:
            self._ask(StartRecording(options=options, overwrite=True))
        except (ConfigError, OSError) as error:
            self.unrecorded += 1
            self.why = str(error)
        # A run is done without its file rather than not at all.
        self.recording = True

    def _end(self) -> None:
        self.recording = False
        # The run's own result belongs into its file.
        time.sleep(_TAIL_S)
        with suppress(ConfigError, OSError):
            file = self._ask(AskRecording()).file
            if file and Path(file).parent == self._directory:
                self._ask(StopRecording())

    def _ask(self, request: RecordRequest) -> RecordAnswer:
        """Return the recorder's answer, also that of its next start."""
        return_s = 0.0 if self._closing else RETURN_S
        return ask(
            self._session,
            RECORDER_SOCKET,
            request,
            RecordAnswer,
            timeout_s=RECORDER_S,
            return_s=return_s,
        )
