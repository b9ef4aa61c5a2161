"""The two haptic endpoints, one cycle at a time: robot on the ground, joystick in space."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Generic, TypeVar

from kontur_av.clock import NS_PER_MS, NS_PER_S
from pipelines.hand.haptic_trace import LATER_FIELDS, HapticTrace, field_values, flags_of
from pipelines.session.probe import Probe
from pipelines.session.session_metrics import ContactRow, SampleReceivedRow, SampleSentRow, StepRow
from telepresence.haptics.authority import Authority, ControlAuthority, PartnerBoard
from telepresence.haptics.bilateral import Handle, HeldJoystick, JoystickSide, RobotSide
from telepresence.haptics.device.handle import OperatedHandle
from telepresence.haptics.device.states import ExperimentName
from telepresence.haptics.envelope import SafetyEnvelope
from telepresence.haptics.haptic_metrics import PressMetrics, WallMetrics
from telepresence.haptics.joystick_controller import PRESS_RATIO
from telepresence.haptics.loop import joystick_link, robot_link
from telepresence.haptics.mediated.controller import MediatedController
from telepresence.haptics.robot import Robot
from telepresence.haptics.robot_controller import RobotControllerModel
from telepresence.haptics.sample import Feedback, carries_stop
from telepresence.haptics.session import JoystickSession, RobotSession
from telepresence.haptics.step_detector import StepDetector
from telepresence.world import WorldState

Side = TypeVar("Side", bound=JoystickSide | RobotSide)

#: Scenes are drawn at 30 pictures a second, for which a state every 10 ms suffices.
_PUBLISH_EVERY = 10
#: Once a millisecond.
CYCLE_NS = NS_PER_MS


class _End(Generic[Side]):
    """Each cycle: call `handle_datagram` for each datagram, `handle_cycle` and `poll_transmit`.

    trace: the rows of the cycles, while somebody reads them.
    """

    def __init__(self, side: Side, probe: Probe) -> None:
        self.side = side
        self.trace = HapticTrace(side.axes.columns)
        self._probe = probe
        self._link = side.link
        # Looked up once: they are called a thousand times a second.
        self.handle_datagram = side.handle_datagram
        self.poll_transmit = side.poll_transmit
        self._cycle = side.handle_cycle
        self._acted = 0
        self._values = field_values("robot" if isinstance(side, RobotSide) else "joystick")
        self._sent = probe.series(SampleSentRow)
        self._received = probe.series(SampleReceivedRow)

    def _has_acted(self) -> bool:
        """Whether the passivity controller has acted since the last row of the trace."""
        before, self._acted = self._acted, self.side.controller.acted
        return before != self._acted

    def _trace_cycle(self, now_ns: int, values: Sequence[float], flags: int) -> None:
        """Add a row. values: of the fields of a cycle."""
        link = self._link
        numbers = link.sent, link.counts.received, link.numbers.newest
        self.trace.add((now_ns, *values, flags, *numbers, *self.side.axes.row()))

    def _of_partner(self) -> bool:
        """Whether samples come from a partner's robot, which tells nobody when it sent them."""
        session = self._link.session
        return isinstance(session, JoystickSession) and session.for_partner

    def publish(self) -> None:
        """Put the counters and stamps into the probe."""
        link = self._link
        self._probe.publish(link.sent_metrics())
        self._probe.publish(link.received_metrics())
        for name, port in self.side.report().items() if self.side.felt else ():
            self._probe.publish(port, name)
        self._sent.extend(link.take_sent_stamps())
        stamps = link.take_received_stamps()
        if not self._of_partner():
            self._received.extend(stamps)


def robot_side(
    envelope: SafetyEnvelope,
    *,
    boot_id: int,
    deadband: bool = False,
    command_hz: int | None = None,
    mediated: bool = False,
    residual: bool = False,
    walls_from_ns: int = 0,
    ownership: ControlAuthority | None = None,
    robot: Robot | None = None,
    plane: Sequence[str] = ("x", "y"),
) -> RobotSide:
    """Return a robot's side within the limits of its envelope.

    boot_id: 1 to 2^24-1; no earlier start of this end had it. residual, walls_from_ns, plane: see
    `RobotSide`. ownership: where a partner may drive, too. robot: the simulated one, if None.
    command_hz: the rate of commands without force feedback; None: with it.
    """
    felt = command_hz is None
    limits = envelope.limits
    model = RobotControllerModel(
        speed_m_s=limits.speed_m_s,
        force_limit_n=limits.force_n,
        half_width_m=limits.half_width_m,
        half_height_m=limits.half_height_m,
    )
    if command_hz is not None:
        # Until the next place comes, the reference goes on.
        model = replace(model, follow_s=max(model.follow_s, 1.0 / command_hz))
    max_age_ns = round(limits.command_max_age_s * NS_PER_S)
    more = 0 if robot is None else len(robot.more)
    return RobotSide(
        felt=felt,
        link=robot_link(
            boot_id=boot_id,
            max_age_ns=max_age_ns,
            deadband=deadband,
            command_hz=command_hz,
            more=more,
        ),
        model=model,
        mediated=mediated,
        residual=residual,
        walls_from_ns=walls_from_ns,
        ownership=ownership,
        envelope=envelope,
        robot=robot,
        plane=plane,
    )


class RobotEnd(_End[RobotSide]):
    """Follows the commands, measures the force, and returns the state of the robot.

    `next_event` returns a state every 10 cycles, and at once when a contact begins or ends. Each
    beginning is a `ContactRow`. Of a mediated side, send as telemetry what `poll_wall` returns in a
    cycle.

    side: if it has an ownership, `handle_datagram` is for datagrams of the joystick in space, and
    `handle_partner` for the partner's; send to the owner alone.
    board: where the joystick in space may drive the partner's robot, with the ownership of `side`.
    Send to it what `board.poll_partner` returns; `poll_transmit` returns what goes to space, of
    either robot.
    """

    def __init__(self, probe: Probe, side: RobotSide, *, board: PartnerBoard | None = None) -> None:
        super().__init__(side, probe)
        assert side.envelope is not None
        self.envelope = side.envelope
        self._ownership = side.ownership
        #: Whether the newest datagram of a joystick had the emergency stop's bit.
        self._stop_of = dict.fromkeys(Authority, False)
        self.board = board
        if board is not None:
            self.handle_datagram = self._handle_routed
            self.poll_transmit = self._poll_routed
        elif side.ownership is not None:
            self.handle_datagram = self._handle_iss
        self.poll_wall = self.side.poll_wall
        self._latest = self.side.link.latest
        self._contact_since_ns: int | None = None
        self._touched_ns: int | None = None
        self._contacts = probe.series(ContactRow)
        self._cycles = 0
        self._state: WorldState | None = None

    def _handle_iss(self, data: bytes, now_ns: int) -> None:
        self._handle_of(Authority.OPERATOR, data, now_ns)

    def handle_partner(self, data: bytes, now_ns: int) -> None:
        """A datagram of the partner's joystick arrived."""
        if self._ownership is not None:
            self._handle_of(Authority.PARTNER, data, now_ns)

    def _handle_of(self, source: Authority, data: bytes, now_ns: int) -> None:
        """Take a datagram of one of two joysticks. Either may stop the robot; the owner drives."""
        assert self._ownership is not None
        stop, before = carries_stop(data), self._stop_of[source]
        self._stop_of[source] = stop
        if self._ownership.takes(source):
            self.side.handle_datagram(data, now_ns)
        elif stop and not before:
            self.envelope.handle_stop(now_ns, f"the joystick of {source.value}")

    def _handle_routed(self, data: bytes, now_ns: int) -> None:
        assert self.board is not None
        if self.board.handle_joystick(data, now_ns):
            self.side.handle_datagram(data, now_ns)

    def _poll_routed(self, now_ns: int) -> bytes | None:
        board, session = self.board, self._link.session
        assert board is not None and isinstance(session, RobotSession)
        if board.left_out:
            if self._link.hearing:
                self._link.forget_peer()
            return board.poll_joystick()
        session.partner = board.is_there(now_ns)
        return self.side.poll_transmit(now_ns)

    def publish(self) -> None:
        """Put the counters and stamps into the probe."""
        super().publish()
        self._probe.publish(self.envelope.report())
        if self._ownership is not None:
            self._probe.publish(self._ownership.report())

    def handle_cycle(self, now_ns: int, advance_ns: int) -> None:
        self._cycle(now_ns, advance_ns)
        robot = self.side.robot
        changed = robot.contact != (self._contact_since_ns is not None)
        if changed:
            self._contact_since_ns = now_ns if robot.contact else None
            if robot.contact:
                self._touched_ns = now_ns
        self._cycles += 1
        if changed or self._cycles % _PUBLISH_EVERY == 0:
            self._state = WorldState(
                now_ns,
                robot.x_m,
                robot.y_m,
                robot.force_n,
                robot.contact,
                self._contact_since_ns,
                self._touched_ns,
                holds=robot.holds,
            )
            if changed and robot.contact:
                # A user's robot touches things of its own, not the LEDs of the board.
                lit = self.side.lit
                self._contacts.add(ContactRow(now_ns, -1 if lit is None else lit))
        if self.trace.rows is not None:
            self._add_row(now_ns)

    def next_event(self) -> WorldState | None:
        state = self._state
        if state is not None:
            self._state = None
        return state

    def _add_row(self, now_ns: int) -> None:
        side, seen = self.side, None if self.board is None else self.board.seen(now_ns)
        if seen is not None:
            # The trace is of the robot that answers the joystick.
            flags = flags_of(
                contact=seen.contact, dead_man=seen.dead_man, acted=False, state=0, lit=None
            )
            more = (side.unknown,) * len(LATER_FIELDS)
            self._trace_cycle(now_ns, (*seen[:4], 0.0, *more), flags)
            return
        command = self._latest(now_ns)
        flags = flags_of(
            contact=side.robot.contact,
            dead_man=command is not None and command.dead_man,
            acted=self._has_acted(),
            state=0 if command is None else command.state,
            lit=side.lit,
        )
        self._trace_cycle(now_ns, self._values(side), flags)


class JoystickEnd(_End[JoystickSide]):
    """Reads the position of the handle, and applies the robot's force to it.

    handle: None for the simulated joystick in the simulated hand. The state of an `OperatedHandle`
        is reported, too.
    boot_id, command_hz: as in `robot_side`.
    mediated, residual, adaptive: the hand feels the wall that `handle_wall` takes (see
        `JoystickSide`, also for `press_ratio`).
    """

    def __init__(
        self,
        probe: Probe,
        *,
        boot_id: int,
        deadband: bool = False,
        command_hz: int | None = None,
        mediated: bool = False,
        residual: bool = False,
        adaptive: bool = False,
        press_ratio: float = PRESS_RATIO,
        handle: Handle | OperatedHandle | None = None,
    ) -> None:
        more = 0 if handle is None else len(handle.more)
        link = joystick_link(boot_id=boot_id, deadband=deadband, command_hz=command_hz, more=more)
        side = JoystickSide(
            link=link,
            handle=handle,
            mediated=mediated,
            residual=residual,
            adaptive=adaptive,
            felt=command_hz is None,
            press_ratio=press_ratio,
        )
        super().__init__(side, probe)
        self.handle_wall = self.side.handle_wall
        held = self.side.handle
        self._operated = held if isinstance(held, OperatedHandle) else None
        self._publish_hand = (
            held.handle_feedback if isinstance(held, OperatedHandle | HeldJoystick) else None
        )
        self._latest = self.side.link.latest
        #: It has left a robot, whose energy counts no more.
        self._leaves = False
        self._steps = StepDetector()
        self._feel, self._felt = self._steps.handle_sample, probe.series(StepRow)

    def follow_experiment(self) -> None:
        """Where a partner has a robot: call it at the start, and after each command of a person.

        Each robot has a session of its own, and no energy of one pays for a force of the other.
        """
        session = self._link.session
        assert self._operated is not None and isinstance(session, JoystickSession)
        operation = self._operated.operation
        russian = operation.experiment is ExperimentName.RUSSIAN
        if russian is not session.for_partner:
            self._link.begin_anew(for_partner=russian)
            self._leaves = True
        side = self.side
        forces = (side.force_x_n, side.force_y_n, *(axis.force_n for axis in side.handle.more))
        if self._leaves and not any(forces):
            # Not before: the force of the last cycle is still to be paid for.
            self._leaves = False
            side.discard_credit()
        operation.partner = self._link.hearing and (russian or session.partner_there)

    def handle_cycle(self, now_ns: int, advance_ns: int) -> None:
        feedback = self._latest(now_ns)
        if feedback is not None:
            self._feel(now_ns, feedback.fx_n, feedback.fy_n, feedback.contact)
        if self._publish_hand is not None:
            self._publish_hand(feedback)
        if self._operated is not None:
            self._operated.command_age_ms = self.side.link.told_age_ms
            self._operated.presses_n = self.side.controller.presses_n
        self._cycle(now_ns, advance_ns)
        if self.trace.rows is not None:
            self._add_row(now_ns, feedback)

    def publish(self) -> None:
        """Put the counters and stamps into the probe, and the instants of the force's steps."""
        super().publish()
        controller = self.side.controller
        if self.side.felt:
            self._probe.publish(
                PressMetrics(
                    presses_n=round(controller.presses_n, 2),
                    gives_n=round(controller.gives_n, 2),
                    beyond_n=round(controller.beyond_n, 2),
                )
            )
        if isinstance(controller, MediatedController):
            renderer = controller.renderer
            self._probe.publish(
                WallMetrics(
                    walls=renderer.used,
                    walls_stale=renderer.stale,
                    walls_garbage=controller.garbage,
                )
            )
        if self._operated is not None:
            self._probe.publish(self._operated.report())
        while (step := self._steps.next_event()) is not None:
            self._felt.add(StepRow(step.instant_ns))

    def _add_row(self, now_ns: int, feedback: Feedback | None) -> None:
        handle = self.side.handle
        flags = flags_of(
            contact=feedback is not None and feedback.contact,
            dead_man=handle.dead_man,
            acted=self._has_acted(),
            state=handle.state,
            lit=None if feedback is None else feedback.lit,
        )
        self._trace_cycle(now_ns, self._values(self.side), flags)
