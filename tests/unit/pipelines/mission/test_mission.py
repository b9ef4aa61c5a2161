"""The ground's side of a mission: what telecommands may do, and what outlives its process."""

from collections import deque

import msgspec
import pytest
from common import repeats
from hypothesis import given, settings
from hypothesis import strategies as st

from kontur_av.clock import NS_PER_MS
from pipelines.mission.mission import MissionGround, MissionMemory, Seen, robot_order
from pipelines.session.mission_messages import RobotStatus
from pipelines.session.task_journal import LinkMeanwhile
from telepresence.haptics.board import LIGHTS_M
from telepresence.tasks.definitions import ControlMode
from telepresence.tasks.experiment import RunStep
from telepresence.tasks.kernel import ChooseCamera, Record
from telepresence.tasks.panel import MissionPanel
from telepresence.tasks.panel_picture import DARK, pack_acknowledgement, parse_picture
from telepresence.tasks.plan import PlannedTask, SessionPlan
from telepresence.tasks.task_files import built_in_tasks
from telepresence.tmtc import k2aci

TICK_NS = 100 * NS_PER_MS


class Ground:
    """A mission's ground with a robot that does at once what it is told."""

    def __init__(self, memory=None, plan=None):
        self.now_ns = 0
        self.robot = RobotStatus(
            boot_id=1, powered=False, mode=ControlMode.POSITION, x_m=0, y_m=0, push_n=0
        )
        self.camera, self.recording, self.messages = "", False, []
        self.signal, self.exercise = True, False
        self.core = MissionGround(built_in_tasks(), plan, now_ns=0, memory=memory)
        self.settle()

    def change(self, **changes):
        self.robot = msgspec.structs.replace(self.robot, **changes)

    def settle(self):
        while (order := self.core.poll_order()) is not None:
            if isinstance(order, ChooseCamera):
                self.camera = order.name
            elif isinstance(order, Record):
                self.recording = order.on
            else:
                self.carry_out(robot_order(order, 1))
        while (message := self.core.poll_message()) is not None:
            self.messages.append(message)
        datagram = self.core.leds.poll_transmit(self.now_ns)
        if datagram is not None:
            number, _ = parse_picture(datagram)
            self.core.leds.handle_datagram(pack_acknowledgement(number), self.now_ns)

    def carry_out(self, told):
        if told.kind == "power":
            self.change(powered=told.on and not self.robot.fault)
        elif told.kind == "mode":
            self.change(mode=told.mode)
        elif told.kind == "move":
            self.change(x_m=told.x_m, y_m=told.y_m, goal_m=(told.x_m, told.y_m))

    def tick(self):
        self.now_ns += TICK_NS
        seen = Seen(
            robot=self.robot,
            camera=self.camera,
            recording=self.recording,
            signal=self.signal,
            link=LinkMeanwhile(0, 0, 0),
            exercise=self.exercise,
        )
        self.core.handle_tick(seen, self.now_ns)
        self.settle()

    def go(self, seconds):
        for _ in range(round(seconds * 10)):
            self.tick()

    def ask(self, name, *arguments):
        refusal = self.core.handle_function(name, arguments, self.now_ns)
        self.settle()
        return refusal

    def panel(self, mode, run):
        task = "aiming" if run else ""
        self.core.handle_message(k2aci.PanelState(mode=mode, task=task, run=run), self.now_ns)
        self.settle()

    @property
    def phase(self):
        return self.core.shown.phase

    @property
    def ended(self):
        """The only run that has ended: its result and why."""
        (row,) = self.core.journal.closed
        return row.result, row.reason


def offered():
    ground = Ground()
    assert ground.ask("select", 0) == ""
    ground.go(2)
    assert ground.phase == "offered"
    return ground


def running():
    ground = offered()
    # That of another task or run is none.
    for task, run in (("line", 1), ("aiming", 8), ("aiming", 1)):
        assert ground.phase == "offered"
        ground.core.handle_message(k2aci.StartTask(task=task, run=run), ground.now_ns)
    assert ground.phase == "running"
    ground.go(1)
    return ground


def test_functions_are_refused_in_words_where_they_cannot_be_done():
    ground = Ground()
    assert ground.ask("abort") == "no task is being done"
    assert "no task is offered" in ground.ask("start")
    assert "no task 99" in ground.ask("select", 99)
    handshake = list(built_in_tasks().tasks).index("handshake")
    assert "needs two hands" in ground.ask("select", handshake)
    lacks = {task.name: task.lacks for task in ground.core.shown.tasks}
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
    # Another start of the process goes on in the same place.
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
    assert ground.ended == ("aborted", "the robot application has a fault")
    assert ground.phase == "idle" and not ground.robot.powered


def test_a_restarted_panel_is_told_its_task_again_or_ends_the_run_as_a_fault_of_the_robot_does():
    ground = offered()
    ground.messages.clear()
    ground.panel(k2aci.PanelMode.WAIT_TASK, 0)
    assert [type(message) for message in ground.messages] == [k2aci.TaskSelected]
    ground = running()
    ground.panel(k2aci.PanelMode.WAIT_TASK, 0)
    ground.go(2)
    assert ground.ended == ("aborted", "the panel was restarted")
    assert not ground.robot.powered and not ground.recording
    fault = "force above 28 N"
    ground = running()
    ground.change(fault=fault)
    ground.go(2)
    result, reason = ground.ended
    assert result == "aborted" and fault in reason


def test_the_next_life_ends_the_run_or_without_a_memory_switches_the_robot_off():
    before = running()
    kept = msgspec.json.decode(msgspec.json.encode(before.core.memory), type=MissionMemory)
    assert kept.started_ns == 2_000 * NS_PER_MS
    ground = Ground(kept)
    assert not ground.robot.powered and ground.core.leds.picture == DARK
    assert ground.messages == [
        k2aci.TaskFinished(task="aiming", run=1, result=k2aci.TaskResult.ABORTED)
    ]
    assert ground.ask("select", 0) == ""
    assert ground.core.shown.run == 2
    # A third life keeps the row.
    (row,) = ground.core.memory.rows
    assert (row.run, row.result) == (1, "aborted")
    assert [run.run for run in ground.core.shown.runs] == [1]
    ground = Ground()
    ground.change(powered=True)
    ground.recording = True
    ground.core.switch_off(ground.now_ns)
    ground.settle()
    assert not ground.robot.powered and not ground.recording
    assert ground.core.leds.picture == DARK


#: Before a step, these.
BEFORE = {
    RunStep.PREPARED: {RunStep.SELECTED},
    RunStep.TOLD: {RunStep.PREPARED},
    RunStep.SHOWN: {RunStep.TOLD},
    RunStep.AT_START: {RunStep.TOLD},
    RunStep.HELD: {RunStep.AT_START},
    RunStep.STARTED: {RunStep.TOLD},
    RunStep.TELEPRESENCE: {RunStep.STARTED},
    RunStep.CONDITION: {RunStep.TELEPRESENCE},
    RunStep.FINISHED: {RunStep.ENDED, RunStep.TOLD},
    RunStep.SEEN: {RunStep.TOLD},
}
ACTIONS = (
    *("task", "task", "finish", "finish", "fix", "fix", "button", "select", "hand", "press"),
    *("release", "abort", "start", "fault", "halt", "link", "kill tasks", "kill panel", "trainer"),
)


class Mission(Ground):
    """Both ends on a link that holds messages back while it is lost."""

    def __init__(self):
        super().__init__()
        self.halted, self.place, self.dead_man, self.reach = "", (0.0, 0.0), False, 0
        self.offered = 0
        self.down, self.runs, self.steps_of = deque(), {}, {}
        self.panel = MissionPanel()

    def do(self, action):
        match action:
            case "select" | "abort" | "start":
                arguments = (0,) if action == "select" else ()
                refusal = self.core.handle_function(action, arguments, self.now_ns)
                self.offered += action == "select" and refusal == ""
            case "button":
                self.panel.handle_button(self.now_ns)
            case "hand":
                at_start = self.place == self.panel.view.start_m
                self.place = (0.05, 0.05) if at_start else self.panel.view.start_m
            case "press" | "release":
                self.dead_man = action == "press"
            case "fix":
                self.halted, self.signal, self.exercise = "", True, False
                self.change(fault="")
            case "finish":
                for _ in range(4):
                    self.reach += 1
                    self.live(8)
            case "fault":
                self.change(fault="" if self.robot.fault else "force above 28 N")
            case "halt":
                self.halted = "" if self.halted else "The joystick is halted"
            case "link":
                self.signal = not self.signal
            case "trainer":
                self.exercise = not self.exercise
            case "kill tasks":
                memory = msgspec.json.encode(self.core.memory)
                kept = msgspec.json.decode(memory, type=MissionMemory)
                self.core = MissionGround(built_in_tasks(), None, now_ns=self.now_ns, memory=kept)
                self.steps_of = {}
            case "kill panel":
                self.panel = MissionPanel()
            case "task":
                self.do_a_task()
        self.live(3)

    def do_a_task(self):
        """What leads from a selection to a run, unless something is in the way."""
        self.do("button")
        for one in ("select", "button"):
            self.do(one)
            self.live(20)
        self.place, self.dead_man = self.panel.view.start_m, False
        self.live(40)
        self.dead_man = True
        self.live(20)

    def live(self, ticks):
        for _ in range(ticks):
            self.move_robot()
            self.tick()
            self.move_panel()
            self.check()

    def move_robot(self):
        self.change(halted=bool(self.halted))
        if self.robot.fault:
            self.change(powered=False)
        if self.robot.powered and self.robot.mode is ControlMode.TELEPRESENCE:
            x_m, y_m = LIGHTS_M[(7, 0, 5, 0)[self.reach % 4]]
            self.change(x_m=x_m, y_m=y_m)

    def move_panel(self):
        panel, now_ns = self.panel, self.now_ns
        panel.handle_contact(self.signal, now_ns)
        panel.handle_handle(*self.place, dead_man=self.dead_man, halted=self.halted, now_ns=now_ns)
        while (message := panel.poll_message()) is not None:
            self.down.append(message)
        if self.signal:
            while self.messages:
                panel.handle_message(self.messages.pop(0), now_ns)
            while self.down:
                self.core.handle_message(self.down.popleft(), now_ns)

    def check(self):
        shown, view = self.core.shown, self.panel.view
        for step in shown.steps:
            before = self.steps_of.setdefault(step.run, [])
            if step.step not in before:
                assert {one.value for one in BEFORE.get(RunStep(step.step), ())} <= {*before}
                before.append(step.step)
        for run in shown.runs:
            self.runs[run.run] = run.result
            did = self.steps_of.get(run.run)
            if did is not None:
                assert (run.result == "finished") is (RunStep.CONDITION in did)
                assert (run.result != "finished") <= (run.reason != "")
                assert not (run.result == "lost_signal" and RunStep.FINISHED in did)
        if shown.phase == "running":
            assert RunStep.STARTED in self.steps_of[shown.run] and shown.run not in self.runs
        if shown.phase == "idle":
            assert (shown.task, shown.elemop, shown.run) == ("", "", 0)
            assert not self.recording
        # What the panel says.
        if view.mode is k2aci.PanelMode.NO_CONTACT:
            assert (view.task, view.goal, view.left_s) == ("", "", None) and not self.signal
        else:
            assert self.signal
        assert view.words != ""
        assert (view.goal != "") <= (view.mode is k2aci.PanelMode.RUNNING)
        assert view.held_s >= 0 and (view.left_s is None or view.left_s >= 0)
        if view.mode is k2aci.PanelMode.FINISHED:
            assert self.runs[view.run] == "finished" and view.words.startswith("Finished")
        if view.mode is k2aci.PanelMode.ERROR:
            assert "Finished" not in view.words
        if view.mode in (k2aci.PanelMode.WAIT_TASK, k2aci.PanelMode.NO_CONTACT):
            assert "Finished" not in view.words


@settings(max_examples=repeats(40))
@given(st.lists(st.sampled_from(ACTIONS), min_size=5, max_size=40))
def test_no_words_of_a_mission_contradict_its_state(actions):
    mission = Mission()
    for action in (*actions, "fix", "abort"):
        mission.do(action)
    # Every run ends once, with the robot off.
    mission.live(80)
    assert mission.phase == "idle" and not mission.robot.powered
    assert [row.run for row in mission.core.memory.rows] == [*range(1, mission.offered + 1)]
