"""The ground's side of a mission: what telecommands may do, and what outlives its process."""

import msgspec
import pytest

from kontur_av.clock import NS_PER_MS
from pipelines.mission.mission import MissionGround, MissionMemory, Seen, robot_order
from pipelines.session.mission_messages import (
    CameraWish,
    ExperimentShown,
    LedsShown,
    PanelShown,
    RobotOrder,
    RobotStatus,
    pack,
    unpack,
)
from pipelines.session.task_journal import LinkMeanwhile
from telepresence.tasks.definitions import ControlMode
from telepresence.tasks.kernel import (
    ChooseCamera,
    ControlRobot,
    MoveRobot,
    PowerRobot,
    Record,
)
from telepresence.tasks.panel_picture import DARK, pack_acknowledgement, parse_picture
from telepresence.tasks.plan import PlannedTask, SessionPlan
from telepresence.tasks.task_files import built_in_tasks
from telepresence.tmtc.k2aci import (
    PanelMode,
    PanelState,
    StartTask,
    TaskFinished,
    TaskResult,
    TaskSelected,
)


class Ground:
    """A mission's ground with a robot that does at once what it is told."""

    def __init__(self, memory=None, plan=None):
        self.now_ns = 0
        self.robot = RobotStatus(
            life=1, powered=False, mode=ControlMode.POSITION, x_m=0, y_m=0, push_n=0
        )
        self.camera, self.recording, self.messages = "", False, []
        self.exercise = False
        self.core = MissionGround(built_in_tasks(), plan, now_ns=0, memory=memory)
        self.settle()

    def change(self, **changes):
        self.robot = msgspec.structs.replace(self.robot, **changes)

    def settle(self):
        while (order := self.core.poll_order()) is not None:
            if isinstance(order, PowerRobot):
                self.change(powered=order.on)
            elif isinstance(order, ControlRobot):
                self.change(mode=order.mode)
            elif isinstance(order, MoveRobot):
                self.change(x_m=order.x_m, y_m=order.y_m, goal_m=(order.x_m, order.y_m))
            elif isinstance(order, ChooseCamera):
                self.camera = order.name
            elif isinstance(order, Record):
                self.recording = order.on
        while (message := self.core.poll_message()) is not None:
            self.messages.append(message)
        datagram = self.core.leds.poll_transmit(self.now_ns)
        if datagram is not None:
            number, _ = parse_picture(datagram)
            self.core.leds.handle_datagram(pack_acknowledgement(number), self.now_ns)

    def go(self, seconds):
        for _ in range(round(seconds * 10)):
            self.now_ns += 100 * NS_PER_MS
            seen = Seen(
                robot=self.robot,
                camera=self.camera,
                recording=self.recording,
                signal=True,
                link=LinkMeanwhile(0, 0, 0),
                exercise=self.exercise,
            )
            self.core.handle_tick(seen, self.now_ns)
            self.settle()

    def ask(self, name, *arguments):
        refusal = self.core.handle_function(name, arguments, self.now_ns)
        self.settle()
        return refusal

    def panel(self, mode, run):
        task = "aiming" if run else ""
        self.core.handle_message(PanelState(mode=mode, task=task, run=run), self.now_ns)
        self.settle()

    @property
    def phase(self):
        return self.core.shown.phase


def offered():
    ground = Ground()
    assert ground.ask("select", 0) == ""
    ground.go(2)
    assert ground.phase == "offered"
    return ground


def running():
    ground = offered()
    ground.core.handle_message(StartTask(task="aiming", run=1), ground.now_ns)
    ground.go(1)
    assert ground.phase == "running"
    return ground


def test_functions_are_refused_in_words_where_they_cannot_be_done():
    ground = Ground()
    assert ground.ask("abort") == "no task is being done"
    assert "no task is offered" in ground.ask("start")
    assert "no task 99" in ground.ask("select", 99)
    handshake = list(built_in_tasks().tasks).index("handshake")
    assert "needs two hands" in ground.ask("select", handshake)
    lacks = {one.name: one.lacks for one in ground.core.shown.tasks}
    assert "needs two hands" in lacks["handshake"] and lacks["line"] == ""
    assert ground.ask("select", 0) == ""
    assert "abort it first" in ground.ask("select", 1)
    ground.go(2)
    assert ground.ask("start") == ""
    ground.go(1)
    assert ground.phase == "running"


def test_a_plan_repeats_a_run_that_failed_and_goes_on_after_one_that_a_person_ended():
    plan = SessionPlan(tasks=(PlannedTask(name="aiming"), PlannedTask(name="line")))
    ground = Ground(plan=plan)
    ground.go(5)
    assert (ground.core.shown.task, ground.core.shown.run) == ("aiming", 1)
    ground.change(fault="too hot")
    ground.go(1)
    ground.change(fault="")
    ground.go(8)
    assert (ground.core.shown.task, ground.core.shown.run) == ("aiming", 2)
    # Another life of the process goes on in the same place.
    assert ground.core.memory.planned == 0
    assert ground.ask("abort") == ""
    ground.go(12)
    assert (ground.core.shown.task, ground.core.shown.run) == ("line", 3)
    assert ground.core.memory.planned == 1
    assert ground.core.telemetry["task"] == list(built_in_tasks().tasks).index("line")


@pytest.mark.parametrize("begin", [offered, running])
def test_a_trainer_lets_a_task_fail_and_says_why(begin):
    ground = begin()
    ground.exercise = True
    ground.go(2)
    (row,) = ground.core.journal.closed
    assert (row.result, row.reason) == ("aborted", "a fault of the trainer's exercise")
    assert ground.phase == "idle" and not ground.robot.powered


def test_a_panel_that_was_restarted_is_told_its_task_again_or_ends_the_run():
    ground = offered()
    ground.messages.clear()
    ground.panel(PanelMode.WAIT_TASK, 0)
    assert [type(one) for one in ground.messages] == [TaskSelected]
    ground = running()
    ground.panel(PanelMode.WAIT_TASK, 0)
    ground.go(2)
    (row,) = ground.core.journal.closed
    assert (row.result, row.reason) == ("aborted", "the panel was restarted")
    assert not ground.robot.powered and not ground.recording


def test_the_next_life_ends_the_run_and_goes_on_with_the_numbers():
    before = running()
    kept = msgspec.json.decode(msgspec.json.encode(before.core.memory), type=MissionMemory)
    ground = Ground(kept)
    assert not ground.robot.powered and ground.core.leds.picture == DARK
    assert ground.messages == [TaskFinished(task="aiming", run=1, result=TaskResult.ABORTED)]
    assert ground.ask("select", 0) == ""
    assert ground.core.shown.run == 2
    # A third life keeps the row.
    (row,) = ground.core.memory.rows
    assert (row.run, row.result) == (1, "aborted")
    assert [run.run for run in ground.core.shown.runs] == [1]


def test_the_next_life_whose_memory_is_lost_switches_the_robot_off():
    ground = Ground()
    ground.change(powered=True)
    ground.recording = True
    ground.core.switch_off(ground.now_ns)
    ground.settle()
    assert not ground.robot.powered and not ground.recording
    assert ground.core.leds.picture == DARK


@pytest.mark.parametrize("fault", ["it does not answer", "force above 28 N"])
def test_a_robot_with_a_fault_ends_the_run(fault):
    ground = running()
    ground.change(fault=fault)
    ground.go(2)
    (row,) = ground.core.journal.closed
    assert row.result == "aborted" and fault in row.reason


def test_messages_are_what_was_packed():
    messages = (
        CameraWish(3, "head"),
        robot_order(MoveRobot(0.01, -0.02), 7),
        RobotOrder(8, "power", on=True),
        Ground().robot,
        offered().core.shown,
        LedsShown.of(DARK),
        PanelShown(
            mode="hold",
            task="aiming",
            run=1,
            text="",
            words="Hold it there.",
            start_m=(0.0, 0.1),
            held_s=1.5,
        ),
    )
    for message in messages:
        assert unpack(type(message), pack(message)) == message
    assert isinstance(messages[4], ExperimentShown) and LedsShown.of(DARK).picture == DARK
