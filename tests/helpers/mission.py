"""Fig. 14 on virtual time: robot, kernel and experimenter below, panel and cosmonaut above."""

from collections import deque
from math import hypot

from telepresence.haptics.bilateral import HeldJoystick, JoystickSide, RobotSide
from telepresence.haptics.loop import joystick_link, robot_link
from telepresence.haptics.robot import Robot
from telepresence.tasks.cosmonaut import LOOK_NS, Cosmonaut, Skill
from telepresence.tasks.experiment import Experiment, Logged, Phase, TaskRun
from telepresence.tasks.kernel import (
    TICK_NS,
    ChooseCamera,
    ControlRobot,
    MoveRobot,
    PowerRobot,
    Record,
    ShowPicture,
    View,
)
from telepresence.tasks.panel import MissionPanel
from telepresence.tasks.panel_picture import LedPanel, PanelSender
from telepresence.tasks.robot_control import RobotControl
from telepresence.tasks.scores import ScoreKeeper
from telepresence.tasks.task_files import built_in_tasks
from telepresence.tmtc.k2aci import Arrived, K2aciEndpoint

MS = 1_000_000


class Mission:
    """One cycle of a millisecond after the other; frames take `delay_ms` each way."""

    def __init__(self, *, delay_ms=10, skill=0.7, seed=1, **options):
        self.now_ns = 0
        self.robot = RobotSide(link=robot_link(boot_id=3), robot=Robot(x_m=-0.01))
        self.control = RobotControl(self.robot.robot)
        self.cosmonaut = Cosmonaut(Skill(level=skill), seed=seed)
        self.joystick = JoystickSide(
            link=joystick_link(boot_id=4), handle=HeldJoystick(hand=self.cosmonaut)
        )
        self.joystick.handle.dead_man = False
        self.experiment = Experiment(built_in_tasks(), **options)
        self.panel = MissionPanel()
        self.ground, self.space = K2aciEndpoint(boot_id=1), K2aciEndpoint(boot_id=2)
        self.sender, self.leds = PanelSender(), LedPanel()
        self.signal = True
        self.halted = ""
        self.camera, self.recording = "", False
        self.records = []
        self.delay_ns = delay_ms * MS
        self._ways = deque(), deque()
        self._pressed = 0
        self.log, self.runs = [], []
        self.keeper = ScoreKeeper()
        #: How far the tip was led without the dead-man button while the hand leads it (m).
        self.led_m = 0.0

    def step(self):
        now_ns = self.now_ns
        self._carry(now_ns)
        self.control.step(now_ns)
        robot, x_m, y_m = self.robot.robot, self.robot.robot.x_m, self.robot.robot.y_m
        self.robot.handle_cycle(now_ns, MS)
        if self.control.telepresent and not self.joystick.handle.dead_man:
            self.led_m += hypot(robot.x_m - x_m, robot.y_m - y_m)
        self.joystick.handle_cycle(now_ns, MS)
        up, down = self._ways
        for way, side, peer in ((up, self.robot, self.joystick), (down, self.joystick, self.robot)):
            if (sample := side.poll_transmit(now_ns)) is not None:
                self._send(way, peer.handle_datagram, sample, now_ns)
        if now_ns % LOOK_NS == 0:
            self._above(now_ns)
        if now_ns % TICK_NS == 0:
            self._below(now_ns)
        self._messages(now_ns)
        self.now_ns += MS

    def run(self, seconds, until=lambda: False):
        for _ in range(round(seconds * 1000)):
            if until():
                return True
            self.step()
        return until()

    def do(self, name, seconds=240):
        """Select a task, and go on until its run is over and the panel has shown it."""
        count = len(self.runs)
        assert self.experiment.select(name, self.now_ns) == ""
        assert self.run(seconds, until=lambda: len(self.runs) > count)
        self.run(3)
        return self.runs[-1]

    def _send(self, way, take, octets, now_ns):
        if self.signal:
            way.append((now_ns + self.delay_ns, take, octets))

    def _carry(self, now_ns):
        for waiting in self._ways:
            if not self.signal:
                waiting.clear()
            while waiting and waiting[0][0] <= now_ns:
                _, take, octets = waiting.popleft()
                take(octets, now_ns)

    def _above(self, now_ns):
        handle = self.joystick.handle
        self.panel.handle_contact(self.signal, now_ns)
        while self._pressed < self.cosmonaut.pressed:
            self._pressed += 1
            self.panel.handle_button(now_ns)
        self.panel.handle_handle(
            handle.x_m, handle.y_m, dead_man=handle.dead_man, halted=self.halted, now_ns=now_ns
        )
        robot = self.robot.robot
        self.cosmonaut.look(
            self.panel.view,
            self.leds.picture(now_ns),
            (robot.x_m, robot.y_m),
            (handle.x_m, handle.y_m),
        )
        handle.dead_man = self.cosmonaut.dead_man

    def view(self):
        robot, control = self.robot.robot, self.control
        way = control._way
        at = way is not None and control.is_at(*way.end)
        return View(
            powered=control.powered,
            mode=control.mode,
            x_m=robot.x_m,
            y_m=robot.y_m,
            push_n=hypot(robot.push_x_n, robot.push_y_n),
            goal_m=way.end if at else None,
            fault=control.fault,
            camera=self.camera,
            shown=self.sender.shown,
            recording=self.recording,
            signal=self.signal,
            halted=bool(self.halted),
        )

    def _below(self, now_ns):
        self.experiment.handle_view(self.view(), now_ns)
        self._carry_out(now_ns)
        while (octets := self.sender.poll_transmit(now_ns)) is not None:
            self.leds.handle_datagram(octets, now_ns)
            while (answer := self.leds.poll_transmit(now_ns)) is not None:
                self.sender.handle_datagram(answer, now_ns)
        if self.experiment.status.phase is Phase.RUNNING:
            view = self.view()
            self.keeper.handle_robot(
                view.x_m, view.y_m, view.push_n, self.experiment.kernel.elemop, self.sender.picture
            )

    def _carry_out(self, now_ns):
        while (order := self.experiment.poll_transmit(now_ns)) is not None:
            if isinstance(order, PowerRobot):
                self.control.set_power(order.on)
            elif isinstance(order, ControlRobot):
                self.control.set_mode(order.mode)
            elif isinstance(order, MoveRobot):
                self.control.move_to(order.x_m, order.y_m, now_ns)
            elif isinstance(order, ChooseCamera):
                self.camera = order.name
            elif isinstance(order, ShowPicture):
                self.sender.show(order.picture, now_ns)
            elif isinstance(order, Record) and order.on is not self.recording:
                self.recording = order.on
                self.records.append((now_ns, order.on))

    def _messages(self, now_ns):
        for end, taker in ((self.space, self.panel), (self.ground, self.experiment)):
            for event in iter(end.next_event, None):
                if isinstance(event, Arrived):
                    taker.handle_message(event.message, now_ns)
        self._carry_out(now_ns)
        up, down = self._ways
        for source, end, way, peer in (
            (self.panel, self.space, down, self.ground),
            (self.experiment, self.ground, up, self.space),
        ):
            for message in iter(source.poll_message, None):
                end.send(message, now_ns)
            while (body := end.poll_transmit(now_ns)) is not None:
                self._send(way, peer.handle_message, body, now_ns)
        for event in iter(self.experiment.next_event, None):
            if isinstance(event, Logged | TaskRun):
                (self.log if isinstance(event, Logged) else self.runs).append(event)
