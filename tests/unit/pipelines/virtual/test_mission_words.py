"""Over random histories of losses, faults, kills and tasks, no words contradict the state."""

from collections import deque

import msgspec
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
from telepresence.tasks.panel_picture import pack_acknowledgement, parse_picture
from telepresence.tasks.task_files import built_in_tasks
from telepresence.tmtc.k2aci import PanelMode

TICK_NS = 100 * NS_PER_MS
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
    *("task", "task", "finish", "finish", "mend", "mend", "button", "select", "hand", "press"),
    *("release", "abort", "start", "fault", "halt", "link", "kill tasks", "kill panel", "trainer"),
)


class Mission:
    """Both ends on a link that holds messages back while it is lost."""

    def __init__(self):
        self.now_ns, self.link, self.trainer, self.fault, self.halted = 0, True, False, "", ""
        self.place, self.dead_man, self.reach = (0.0, 0.0), False, 0
        self.robot = RobotStatus(
            life=1, powered=False, mode=ControlMode.POSITION, x_m=0, y_m=0, push_n=0
        )
        self.camera, self.recording = "", False
        self.up, self.down = deque(), deque()
        self.runs, self.steps = {}, {}
        self.ground = MissionGround(built_in_tasks(), None, now_ns=0)
        self.panel = MissionPanel()

    def do(self, action):
        ground, now_ns = self.ground, self.now_ns
        match action:
            case "select" | "abort" | "start":
                ground.handle_function(action, (0,) if action == "select" else (), now_ns)
            case "button":
                self.panel.handle_button(now_ns)
            case "hand":
                at_start = self.place == self.panel.view.start_m
                self.place = (0.05, 0.05) if at_start else self.panel.view.start_m
            case "press" | "release":
                self.dead_man = action == "press"
            case "mend":
                self.fault, self.halted, self.link, self.trainer = "", "", True, False
            case "finish":
                for _ in range(4):
                    self.reach += 1
                    self.go(8)
            case "fault":
                self.fault = "" if self.fault else "force above 28 N"
            case "halt":
                self.halted = "" if self.halted else "The joystick is halted"
            case "link":
                self.link = not self.link
            case "trainer":
                self.trainer = not self.trainer
            case "kill tasks":
                memory = msgspec.json.encode(ground.memory)
                kept = msgspec.json.decode(memory, type=MissionMemory)
                self.ground = MissionGround(built_in_tasks(), None, now_ns=now_ns, memory=kept)
                self.steps = {}
            case "kill panel":
                self.panel = MissionPanel()
            case "task":
                self.do_a_task()
        self.go(3)

    def do_a_task(self):
        """What leads from a selection to a run, unless something is in the way."""
        self.do("button")
        for one in ("select", "button"):
            self.do(one)
            self.go(20)
        self.place, self.dead_man = self.panel.view.start_m, False
        self.go(40)
        self.dead_man = True
        self.go(20)

    def go(self, ticks):
        for _ in range(ticks):
            self.now_ns += TICK_NS
            self.tick()
            self.check()

    def tick(self):
        ground, panel, now_ns = self.ground, self.panel, self.now_ns
        if self.fault:
            self.robot = msgspec.structs.replace(self.robot, powered=False)
        x_m, y_m = LIGHTS_M[(7, 0, 5, 0)[self.reach % 4]]
        if self.robot.powered and self.robot.mode is ControlMode.TELEPRESENCE:
            self.robot = msgspec.structs.replace(self.robot, x_m=x_m, y_m=y_m)
        robot = msgspec.structs.replace(self.robot, fault=self.fault, halted=bool(self.halted))
        seen = Seen(
            robot=robot,
            camera=self.camera,
            recording=self.recording,
            signal=self.link,
            link=LinkMeanwhile(0, 0, 0),
            exercise=self.trainer,
        )
        ground.handle_tick(seen, now_ns)
        panel.handle_contact(self.link, now_ns)
        panel.handle_handle(*self.place, dead_man=self.dead_man, halted=self.halted, now_ns=now_ns)
        while (order := ground.poll_order()) is not None:
            self.carry_out(order)
        datagram = ground.leds.poll_transmit(now_ns)
        if datagram is not None:
            ground.leds.handle_datagram(pack_acknowledgement(parse_picture(datagram)[0]), now_ns)
        while (message := ground.poll_message()) is not None:
            self.up.append(message)
        while (message := panel.poll_message()) is not None:
            self.down.append(message)
        if self.link:
            while self.up:
                panel.handle_message(self.up.popleft(), now_ns)
            while self.down:
                ground.handle_message(self.down.popleft(), now_ns)

    def carry_out(self, order):
        told = robot_order(order, 1) if not isinstance(order, ChooseCamera | Record) else None
        if told is None:
            self.camera = order.name if isinstance(order, ChooseCamera) else self.camera
            self.recording = order.on if isinstance(order, Record) else self.recording
        elif told.kind == "power":
            self.robot = msgspec.structs.replace(self.robot, powered=told.on and not self.fault)
        elif told.kind == "mode":
            self.robot = msgspec.structs.replace(self.robot, mode=told.mode)
        elif told.kind == "move":
            goal = told.x_m, told.y_m
            self.robot = msgspec.structs.replace(self.robot, x_m=goal[0], y_m=goal[1], goal_m=goal)

    def check(self):
        shown, view = self.ground.shown, self.panel.view
        for step in shown.steps:
            before = self.steps.setdefault(step.run, [])
            if step.step not in before:
                assert {one.value for one in BEFORE.get(RunStep(step.step), ())} <= {*before}
                before.append(step.step)
        for run in shown.runs:
            self.runs[run.run] = run.result
            did = self.steps.get(run.run)
            if did is not None:
                assert (run.result == "finished") is (RunStep.CONDITION in did)
                assert (run.result != "finished") <= (run.reason != "")
                assert not (run.result == "lost_signal" and RunStep.FINISHED in did)
        if shown.phase == "running":
            assert RunStep.STARTED in self.steps[shown.run] and shown.run not in self.runs
        if shown.phase == "idle":
            assert (shown.task, shown.elemop, shown.run) == ("", "", 0)
            assert not self.recording
        # What the panel says.
        if view.mode is PanelMode.NO_CONTACT:
            assert (view.task, view.goal, view.left_s) == ("", "", None) and not self.link
        else:
            assert self.link
        assert view.words != ""
        assert (view.goal != "") <= (view.mode is PanelMode.RUNNING)
        assert view.held_s >= 0 and (view.left_s is None or view.left_s >= 0)
        if view.mode is PanelMode.FINISHED:
            assert self.runs[view.run] == "finished" and view.words.startswith("Finished")
        if view.mode is PanelMode.ERROR:
            assert "Finished" not in view.words
        if view.mode in (PanelMode.WAIT_TASK, PanelMode.NO_CONTACT):
            assert "Finished" not in view.words


@settings(max_examples=60, deadline=None)
@given(st.lists(st.sampled_from(ACTIONS), min_size=5, max_size=40))
def test_no_words_of_a_mission_contradict_its_state(actions):
    mission = Mission()
    for action in actions:
        mission.do(action)
