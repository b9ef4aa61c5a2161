"""The two sides of the bilateral exchange, each with everything that it does in one 1 ms cycle.

A side is a core. In each cycle, call `handle_datagram` for every datagram received, then
`handle_cycle`, then send what `poll_transmit` returns. Two sides in one process, with a channel
between them, form the whole control loop.
"""

from collections.abc import Sequence
from math import hypot, nan
from typing import Any, Protocol

from kontur_av.clock import NS_PER_MS, NS_PER_S
from telepresence.haptics.authority import ControlAuthority
from telepresence.haptics.axes import MoreAxis
from telepresence.haptics.axes_control import JoystickAxes, RobotAxes
from telepresence.haptics.board import Board
from telepresence.haptics.envelope import Hold, SafetyEnvelope
from telepresence.haptics.hand import TAP_TARGETS, Hand, HandModel, Waypoint
from telepresence.haptics.haptic_metrics import PortMetrics
from telepresence.haptics.joystick import Joystick
from telepresence.haptics.joystick_controller import (
    PRESS_RATIO,
    JoystickController,
    JoystickControllerModel,
)
from telepresence.haptics.loop import HapticLink, joystick_link, robot_link
from telepresence.haptics.mediated.controller import MediatedController
from telepresence.haptics.mediated.estimator import Residual, WallEstimator
from telepresence.haptics.robot import Robot
from telepresence.haptics.robot_controller import RobotController, RobotControllerModel
from telepresence.haptics.sample import STATE_HALTED, Command, Drive, Feedback
from telepresence.haptics.session import RobotSession

#: Longest interval that one call simulates. After a stall, the rest is dropped.
_MAX_ADVANCE_NS = 50 * NS_PER_MS
#: A robot that estimates walls and starts in a contact lets go for so long, or until it knows the
#: wall: it has no credit to move the tip, and a tip that rests reveals no wall.
_LETS_GO_NS = 300 * NS_PER_MS
#: A longer round trip counts once it has lasted for so long.
_LONGER_NS = 500 * NS_PER_MS
#: Skips `Command.__new__`, which is one more Python call a thousand times a second.
_tuple = tuple.__new__


class Handle(Protocol):
    """The handle of a joystick with a hand on it, simulated or real.

    x_m, y_m: position (m).
    force_limit_n: the force that its motors can exert now (N).
    dead_man, buttons, state, stop, blind: the values that the command samples carry.
    more: the axes behind x and y; `step` applies their forces, too.
    """

    x_m: float
    y_m: float
    force_limit_n: float
    dead_man: bool
    buttons: int
    state: int
    stop: bool
    blind: bool
    more: Sequence[MoreAxis]

    def step(self, fx_n: float, fy_n: float, dt_ns: int) -> None:
        """Apply this force (N, N) for `dt_ns` (at most 1 ms) and update the position."""


class HeldJoystick(Joystick):
    """The simulated joystick in a simulated hand; a `Handle`."""

    def __init__(self, hand: Hand) -> None:
        self.hand = hand
        self.robot_waits = False
        self.drive: Drive = ""
        super().__init__(x_m=hand.x_m, y_m=hand.y_m)

    def handle_feedback(self, feedback: Feedback | None) -> None:
        """Let the hand know whether the robot is heard, and waits for a press."""
        # Most samples are of a robot that the hand drives.
        self.drive = "" if feedback is None else feedback.drive if feedback[7] else "hand"
        waiting = self.robot_waits = feedback is not None and feedback.waiting
        self.hand.handle_robot(feedback is not None, waiting, self.x_m, self.y_m)
        self.dead_man = self.hand.dead_man

    def step(self, fx_n: float, fy_n: float, dt_ns: int) -> None:
        """Advance by `dt_ns` with this motor force (N, N)."""
        hand = self.hand
        hand_x, hand_y = hand.force(self.x_m, self.y_m, self.vx_m_s, self.vy_m_s, dt_ns)
        self.push(fx_n, fy_n, hand_x, hand_y, hand.mass_kg, dt_ns)


class _Side:
    """The common part of both sides: the link, the timing of a cycle, and the report.

    unknown: of what this side does not measure.
    """

    unknown = nan

    link: HapticLink[Any, Any]
    controller: JoystickController | RobotController
    axes: JoystickAxes | RobotAxes

    def __init__(self) -> None:
        self.force_x_n = self.force_y_n = 0.0
        self._acted = 0
        # Bound once, because they are called a thousand times a second.
        self.handle_datagram = self.link.handle_datagram
        self.poll_transmit = self.link.poll_transmit

    def _cycle(self, heard: Any, dt_ns: int) -> None:
        """Advance by `dt_ns`, at most 1 ms, with the peer's newest sample, or None."""
        raise NotImplementedError

    def _advance(self, now_ns: int, advance_ns: int) -> bool:
        """Advance by `advance_ns`, at most 50 ms; return whether the controller acted."""
        link, controller = self.link, self.controller
        heard = link.latest(now_ns)
        if advance_ns > NS_PER_MS:
            advance_ns = min(advance_ns, _MAX_ADVANCE_NS)
            while advance_ns > NS_PER_MS:
                self._cycle(heard, NS_PER_MS)
                advance_ns -= NS_PER_MS
        self._cycle(heard, advance_ns)
        acted, self._acted = controller.acted != self._acted, controller.acted
        return acted

    def discard_credit(self) -> None:
        """No energy that was granted so far pays for anything that follows."""
        for each in (self.controller, *self.axes.controllers):
            each.port.discard_credit(max(0.0, each.port.credit_j))

    def report(self) -> dict[str, PortMetrics]:
        """Return each port's energies (µJ) and counts: "" of x and y, the others by their axis."""
        return {"": self.controller.report(), **self.axes.report()}


class JoystickSide(_Side):
    """The joystick's side: handle, controller and link.

    passive: if False, the passivity controller only observes.
    script, hand: intended movement and muscles of the simulated hand.
    handle: used instead of the simulated joystick in that hand.
    model: parameters of the controller.
    mediated: the force is that of the newest wall of `handle_wall`, not the robot's delayed one.
    residual: with `mediated`, also what that wall does not explain of the robot's.
    adaptive: with both, directly until the robot tells its first wall.
    felt: if False, the hand feels no force and no damping.
    press_ratio: how many times as hard as the hand feels the robot may press, beside 2 N.

    force_x_n, force_y_n: the force displayed now (N).
    """

    def __init__(
        self,
        *,
        passive: bool = True,
        script: Sequence[Waypoint] = TAP_TARGETS,
        hand: HandModel | None = None,
        handle: Handle | None = None,
        model: JoystickControllerModel | None = None,
        link: HapticLink[Command, Feedback] | None = None,
        mediated: bool = False,
        residual: bool = False,
        adaptive: bool = False,
        felt: bool = True,
        press_ratio: float = PRESS_RATIO,
    ) -> None:
        self.felt = felt
        passive = passive and felt
        self.handle: Handle = handle or HeldJoystick(hand=Hand(hand, script=script))
        self.controller: JoystickController = (
            MediatedController(model, passive=passive, residual=residual, adaptive=adaptive)
            if mediated
            else JoystickController(model, passive=passive)
        )
        self.controller.press_ratio = press_ratio
        self.link: HapticLink[Command, Feedback] = link or joystick_link()
        self._last_ns = NS_PER_MS
        self._restarts = 0
        self.axes: JoystickAxes = JoystickAxes(self.handle.more, model, passive=passive)
        super().__init__()

    def handle_cycle(self, now_ns: int, advance_ns: int) -> None:
        """Run one cycle, which advances the handle by `advance_ns`, at most 50 ms."""
        if self.link.session.restarts != self._restarts:
            self._restarts = self.link.session.restarts
            if isinstance(self.controller, MediatedController):
                self.controller.handle_restart()
        acted = self._advance(now_ns, advance_ns)
        handle, controller = self.handle, self.controller
        state = handle.state
        back_x_m, back_y_m = controller.held_back_m
        command = (
            handle.x_m + back_x_m,
            handle.y_m + back_y_m,
            controller.port.granted_uj,
            handle.dead_man,
            state,
            handle.buttons,
            acted,
            state >= STATE_HALTED,
            handle.stop,
            handle.blind,
            self.axes.values() if handle.more else (),
        )
        self.link.handle_local(_tuple(Command, command), now_ns)

    def handle_wall(self, datagram: bytes) -> None:
        """A wall of the robot's side arrived. Garbage is counted; this never raises."""
        if isinstance(self.controller, MediatedController):
            self.controller.handle_wall(datagram)

    def _cycle(self, feedback: Feedback | None, dt_ns: int) -> None:
        if dt_ns <= 0:
            return
        handle, controller = self.handle, self.controller
        controller.limit_n = limit_n = handle.force_limit_n if self.felt else 0.0
        # The handle covered its last distance in the previous step's time, not in this step's.
        fx, fy = controller.step(feedback, handle.x_m, handle.y_m, self._last_ns)
        if handle.more:
            self.axes.step(feedback, limit_n, self._last_ns)
        self._last_ns = dt_ns
        self.force_x_n, self.force_y_n = fx, fy
        handle.step(fx, fy, dt_ns)


class RobotSide(_Side):
    """The robot's side: robot, board, controller and link.

    passive: if False, the passivity controller only observes.
    board: what the tip can touch.
    robot: used instead of the default robot.
    model: parameters of the controller.
    mediated: the wall is estimated; send what `poll_wall` returns as telemetry.
    residual: with `mediated`, feedback has only the force that the told wall does not explain.
    walls_from_ns: no wall is told before the measured round trip has been so long.
    ownership: who may drive, where a partner can; the caller asks it for each datagram.
    envelope: whether the robot may follow the hand; None: whenever a fresh command has the dead-man
    button pressed.

    plane: which of x and y the hand drives; the others stay.
    felt: if False, the hand feels no force, so no energy passes.

    force_x_n, force_y_n: the coordinating force (N). For `robot`, see `Robot`.
    A robot that is not coupled follows its own mode, and the operator feels nothing.
    """

    def __init__(
        self,
        *,
        passive: bool = True,
        board: Board | None = None,
        robot: Robot | None = None,
        model: RobotControllerModel | None = None,
        link: HapticLink[Feedback, Command] | None = None,
        mediated: bool = False,
        residual: bool = False,
        walls_from_ns: int = 0,
        ownership: ControlAuthority | None = None,
        envelope: SafetyEnvelope | None = None,
        plane: Sequence[str] = ("x", "y"),
        felt: bool = True,
    ) -> None:
        self.felt = felt
        passive = passive and felt
        self.robot = robot = robot or Robot(board=board)
        #: None: both.
        self._plane = None if {"x", "y"} <= {*plane} else ("x" in plane, "y" in plane)
        self.ownership = ownership
        self.envelope = envelope
        self._restarts = 0
        #: The robot's place less the hand's, as the estimator knows it.
        self._offset_m = (0.0, 0.0)
        self._now_ns = 0
        self.estimator = WallEstimator() if mediated else None
        self._walls_from_ns, self._longer_ns = walls_from_ns, 0
        self._lets_go_ns = _LETS_GO_NS
        self._residual = Residual() if mediated and residual else None
        self.controller: RobotController = RobotController(
            model, passive=passive, x_m=robot.x_m, y_m=robot.y_m
        )
        self.axes: RobotAxes = RobotAxes(robot.more, self.controller.model, passive=passive)
        self.link: HapticLink[Feedback, Command] = link or robot_link()
        assert isinstance(self.link.session, RobotSession) and self.link.probe is not None
        self._session, self._probe = self.link.session, self.link.probe
        self._asking = self._session.asking
        self.lit: int | None = None
        super().__init__()

    def handle_cycle(self, now_ns: int, advance_ns: int) -> None:
        """Run one cycle, which advances the robot by `advance_ns`, at most 50 ms."""
        robot, controller = self.robot, self.controller
        # The force that a step measures belongs to the position before it.
        x_m, y_m = robot.x_m, robot.y_m
        self._now_ns = now_ns
        envelope, estimator, probe = self.envelope, self.estimator, self._probe
        if self._session.restarts != self._restarts:
            self._restarts = self._session.restarts
            if envelope is not None:
                envelope.require_press(Hold.JOYSTICK_STARTED)
        if estimator is not None and self._session.asking != self._asking:
            # A joystick that starts asks for a session long before one begins.
            self._asking = self._session.asking
            estimator.publish_again()
        if envelope is not None:
            envelope.command_age_ns = probe.age_ns(now_ns) if probe.answered else None
        told = estimator is not None and estimator.told is not None
        tells = estimator is not None and not self._walls_from_ns
        controller.set_trip((probe.trip_ns or 0) / NS_PER_S, told=told, tells=tells)
        acted = self._advance(now_ns, advance_ns)
        contact = robot.contact or (bool(robot.more) and any(axis.contact for axis in robot.more))
        if self.ownership is not None:
            speed_m_s = hypot(robot.vx_m_s, robot.vy_m_s, *(one.speed_m_s for one in robot.more))
            if self.ownership.handle_robot(speed_m_s, now_ns):
                # No energy of the owner before pays for a movement of the new one.
                self.discard_credit()
                if envelope is not None:
                    envelope.require_press(Hold.OWNER)
        push_x, push_y = robot.push_x_n, robot.push_y_n
        if estimator is not None:
            if envelope is not None:
                # The joystick renders the wall at the hand.
                if envelope.offset_m != self._offset_m:
                    old_x, old_y = self._offset_m
                    self._offset_m = off_x, off_y = envelope.offset_m
                    estimator.handle_shift(old_x - off_x, old_y - off_y)
                x_m, y_m = x_m - self._offset_m[0], y_m - self._offset_m[1]
            estimator.handle_sample(now_ns, x_m, y_m, push_x, push_y, contact)
            if self._residual is not None:
                rest_n = self._residual.rest_n
                push_x, push_y = rest_n(estimator.told, x_m, y_m, push_x, push_y, now_ns)
        self.lit = lit = robot.led()
        feedback = (
            push_x,
            push_y,
            controller.port.granted_uj,
            contact,
            robot.mode,
            lit,
            acted,
            not robot.coupled,
            envelope is not None and envelope.waiting,
            envelope is not None and envelope.stopped,
            envelope is not None and envelope.blind,
            self.axes.values() if robot.more else (),
        )
        self.link.handle_local(_tuple(Feedback, feedback), now_ns)

    def poll_wall(self, now_ns: int) -> bytes | None:
        """Return the message with the wall to send now, or None."""
        if self.estimator is None:
            return None
        if self._walls_from_ns:
            trip_ns = self._probe.trip_ns
            if trip_ns is None or trip_ns < self._walls_from_ns:
                self._longer_ns = now_ns
                return None
            if now_ns - self._longer_ns < _LONGER_NS:
                return None
            self._walls_from_ns = 0
        return self.estimator.poll_transmit(now_ns, heard=self.link.hearing)

    def _cycle(self, command: Command | None, dt_ns: int) -> None:
        if dt_ns <= 0:
            return
        robot, controller = self.robot, self.controller
        if not robot.coupled:
            robot.drive(dt_ns)
            controller.release(robot.x_m, robot.y_m)
            self.force_x_n = self.force_y_n = 0.0
            self.axes.release()
            if self.envelope is not None:
                self.envelope.handle_off(command, self._now_ns)
            return
        if self._lets_go_ns > 0 and self.estimator is not None:
            self._lets_go_ns -= dt_ns
            unknown = robot.contact and self.estimator.wall is None
            controller.letting_go = unknown and self._lets_go_ns > 0
        envelope = self.envelope
        if envelope is not None:
            command = envelope.admit(
                command, controller.reference_x_m, controller.reference_y_m, self._now_ns
            )
            controller.speed_m_s = envelope.speed_m_s
        if self._plane is not None and command is not None:
            drives_x, drives_y = self._plane
            command = command._replace(
                x_m=command.x_m if drives_x else controller.reference_x_m,
                y_m=command.y_m if drives_y else controller.reference_y_m,
            )
        x, y, vx, vy = robot.x_m, robot.y_m, robot.vx_m_s, robot.vy_m_s
        fx, fy = controller.step(command, x, y, vx, vy, dt_ns, touching=robot.contact)
        self.force_x_n, self.force_y_n = fx, fy
        if robot.more:
            presses, share = 0, 1.0
            if envelope is not None:
                presses, share = envelope.presses, envelope.speed_m_s / envelope.limits.speed_m_s
            self.axes.step(command, dt_ns, presses=presses, speed=share)
        robot.step(fx, fy, dt_ns)
