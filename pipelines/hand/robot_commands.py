"""What the processes of robot and joystick are told, and what they tell. Cores."""

from math import hypot

from kontur_av.clock import NS_PER_MS, NS_PER_S
from pipelines.hand.hand_topics import (
    MOST_CHARACTERS,
    AxisStatus,
    HandRequest,
    JoystickStatus,
    RobotOrders,
)
from pipelines.hand.haptic_trace import FIELDS, WatchedTopic, field_values
from pipelines.session.mission_messages import RobotCommand, RobotOrder, RobotStatus
from telepresence.haptics.authority import Authority, PartnerBoard
from telepresence.haptics.bilateral import RobotSide
from telepresence.haptics.device.handle import OperatedHandle
from telepresence.haptics.device.states import REQUESTS
from telepresence.haptics.envelope import SafetyEnvelope
from telepresence.haptics.haptic_metrics import RobotMetrics
from telepresence.haptics.robot import RobotCapabilities
from telepresence.haptics.sample import STATE_HALTED
from telepresence.tasks.definitions import ControlMode
from telepresence.tasks.robot_control import RobotControl, RobotLimits

#: An unchanged status is told at this interval.
STATUS_NS = 50 * NS_PER_MS
_RATE_NS = NS_PER_S
_TELECOMMAND = "a telecommand"
_LEFT_OUT = "the joystick drives the partner's robot: start the German experiment first"


class RobotCommands:
    """Call `step` before each of the robot's cycles, and `poll_status` every few cycles.

    tasks: the robot is off at first, so that a killed controller is not on again by itself.
    Otherwise it is on, and in telepresence. What was sent before `now_ns` is ignored: it was for an
    earlier start.

    orders: of an earlier start; None for none. In a session with tasks the kernel orders anew.
    board: where a partner's robot may have the joystick. The robot is off meanwhile, and then on
    again if it was; with tasks the kernel orders that.
    """

    def __init__(
        self,
        side: RobotSide,
        *,
        boot_id: int,
        tasks: bool,
        now_ns: int,
        orders: RobotOrders | None = None,
        board: PartnerBoard | None = None,
    ) -> None:
        powered = not tasks
        mode = ControlMode.POSITION if tasks else ControlMode.TELEPRESENCE
        if orders is not None and not tasks:
            powered, mode = orders.powered, ControlMode(orders.mode)
        self.control = RobotControl(
            side.robot, limits=limits_of(side.robot.capabilities), powered=powered, mode=mode
        )
        self._envelope = side.envelope or SafetyEnvelope()
        self._link, self._side = side.link, side
        self._values = field_values("robot")
        self._board, self._tasks = board, tasks
        #: It is on again once it is no longer left out.
        self._again = False
        self._boot_id = boot_id
        self._began_ns = now_ns
        self._handled = 0
        self._commanded: int | None = None
        self._refusal = ""
        self._told: tuple[object, ...] | None = None
        self._due_ns = now_ns
        self._steps, self._counted_ns, self._step_hz = 0, now_ns, 0.0

    @property
    def orders(self) -> RobotOrders:
        """What a restarted controller goes on with."""
        control, board = self.control, self._board
        return RobotOrders(
            powered=control.powered or self._again,
            mode=control.mode.value,
            board=board is not None and board.ownership.wanted is Authority.PARTNER,
        )

    def step(self, now_ns: int) -> None:
        """Once in each cycle, before the robot moves."""
        control, envelope = self.control, self._envelope
        if envelope.stopped is not control.stopped:
            control.handle_stop(envelope.stopped)
            self._again = False
        if self._board is not None and self._board.left_out is not bool(control.left_out):
            self._leave_out(control, self._board.left_out)
        control.step(now_ns)

    def _leave_out(self, control: RobotControl, left_out: bool) -> None:
        again = control.powered and not self._tasks if left_out else False
        power_on, self._again = self._again, again
        control.handle_left_out(_LEFT_OUT if left_out else "")
        if power_on:
            # Its reference is where it is, and motion needs a new press.
            control.set_power(True)

    def handle_order(self, order: RobotOrder, sent_ns: int, now_ns: int) -> None:
        """An order of the kernel. The controller counts those that it refuses."""
        if sent_ns < self._began_ns:
            return
        self._handled = order.number
        control = self.control
        if order.kind == "power":
            control.set_power(order.on)
        elif order.kind == "mode":
            control.set_mode(order.mode)
        elif order.kind == "move":
            control.move_to(order.x_m, order.y_m, now_ns)
        else:
            control.reset()

    def handle_command(self, command: RobotCommand, sent_ns: int, now_ns: int) -> None:
        """A telecommand. The status answers it."""
        if sent_ns < self._began_ns:
            return
        self._commanded, self._refusal = command.number, self._carry_out(command, now_ns)
        if self._refusal:
            self._envelope.add_event(f"{command.function} refused: {self._refusal}", now_ns)

    def poll_status(self, now_ns: int) -> RobotStatus | None:
        """Return the status if it is due: after what others asked for, at faults, every 50 ms."""
        control = self.control
        hold = self._envelope.hold
        present = (
            (control.powered, control.mode, control.fault, hold, self._envelope.stopped),
            (self._envelope.barred, self._envelope.blind),
            (self._handled, self._commanded),
        )
        if now_ns < self._due_ns and present == self._told:
            return None
        self._due_ns, self._told = now_ns + STATUS_NS, present
        return self.status(now_ns)

    def report(self) -> RobotMetrics:
        """Return the robot's fault, and how many there were."""
        control = self.control
        return RobotMetrics(fault=control.fault, error=control.robot.error, faults=control.faults)

    def status(self, now_ns: int) -> RobotStatus:
        if now_ns - self._counted_ns >= _RATE_NS:
            steps = self.control.steps
            self._step_hz = (steps - self._steps) / ((now_ns - self._counted_ns) / NS_PER_S)
            self._steps, self._counted_ns = steps, now_ns
        control, robot, command = self.control, self.control.robot, self._link.latest(now_ns)
        envelope = self._envelope
        safety = envelope.report()
        return RobotStatus(
            boot_id=self._boot_id,
            powered=control.powered,
            mode=control.mode,
            x_m=robot.x_m,
            y_m=robot.y_m,
            push_n=hypot(robot.push_x_n, robot.push_y_n),
            goal_m=control.reached_m,
            fault=control.fault,
            faults=control.faults,
            refused=control.refused,
            handled=self._handled,
            halted=command is not None and command.state >= STATE_HALTED,
            error=control.kind.value,
            commanded=self._commanded,
            command_refusal=self._refusal,
            step_hz=self._step_hz,
            hold=safety.hold.value,
            waiting=safety.waiting,
            stopped=envelope.stopped,
            stopped_by=envelope.stopped_by,
            offset_mm=safety.offset_mm,
            holds=robot.holds,
            joints=robot.joints,
            axes=tuple(
                (one.capabilities.name, one.position_m / one.lever_m, one.push_n * one.lever_m)
                for one in robot.more
            ),
            partner="none" if self._board is None else self._board.state(now_ns),
            barred=envelope.barred.value,
            blind=envelope.blind,
            partner_seen=self._partner_seen(now_ns),
            fields={
                each.parameter: float(value)
                for each, value in zip(FIELDS, self._values(self._side), strict=True)
                if each.parameter
            },
        )

    def _partner_seen(self, now_ns: int) -> tuple[float, float, float, bool, int] | None:
        seen = None if self._board is None else self._board.seen(now_ns)
        if seen is None:
            return None
        force_n = hypot(seen.fx_n, seen.fy_n)
        return seen.x_m, seen.y_m, force_n, seen.contact, seen.age_ns // NS_PER_MS

    def _carry_out(self, command: RobotCommand, now_ns: int) -> str:
        control, envelope = self.control, self._envelope
        match command.function:
            case "power_on":
                return control.set_power(True)
            case "power_off":
                self._again = False
                return control.set_power(False)
            case "reset_error":
                return control.reset()
            case "emergency_stop":
                envelope.handle_stop(now_ns, _TELECOMMAND)
                return ""
            case "release_stop":
                return envelope.handle_stop_released(now_ns, _TELECOMMAND)
            case "set_mode":
                return control.set_mode(command.mode)
        return f"the robot has no function {command.function}"


def limits_of(capabilities: RobotCapabilities | None) -> RobotLimits | None:
    """At twice what a user's robot can do it is switched off; None: the simulated one's limits."""
    if capabilities is None:
        return None
    return RobotLimits(
        force_n=2.0 * capabilities.force_limit_n,
        width_m=capabilities.half_width_m,
        height_m=capabilities.half_height_m,
        fastest_m_s=2.0 * capabilities.speed_m_s,
    )


#: An unchanged state is told at this interval.
_ANEW_NS = 100 * NS_PER_MS

_Answer = tuple[int | None, str]


class JoystickStatusTeller(WatchedTopic):
    """Call `handle_request` for each request and `poll_status` every few cycles.

    The state is told only while it has readers: at each change, and every 100 ms.
    """

    def __init__(self, handle: OperatedHandle) -> None:
        super().__init__()
        self._handle = handle
        self._told: tuple[object, ...] | None = None
        self._anew_ns = 0
        #: Number of the newest command, and why it was refused: of persons, and by telecommand.
        self._answered: _Answer = (None, "")
        self._commanded: _Answer = (None, "")

    def handle_request(self, request: HandRequest) -> None:
        """Carry out a command; one that no person may give is ignored."""
        self._answered = self._carried_out(request) or self._answered

    def handle_telecommand(self, request: HandRequest) -> None:
        """The same for a telecommand, which has numbers of its own."""
        self._commanded = self._carried_out(request, "by a telecommand") or self._commanded

    def _carried_out(self, request: HandRequest, *by: str) -> _Answer | None:
        if request.event not in REQUESTS:
            return None
        return request.number, self._handle.handle_command(request.event, *by)[:MOST_CHARACTERS]

    def poll_status(self, now_ns: int) -> JoystickStatus | None:
        """Return the state if it is due, or None."""
        if not self.watched:
            return None
        handle = self._handle
        operation = handle.operation
        reason = operation.prompt or operation.reason or operation.supervisor.reason
        test = operation.test
        (answered, refusal), (commanded, command_refusal) = self._answered, self._commanded
        robot = (
            handle.robot_waits,
            handle.robot_stopped,
            handle.drive,
            handle.blind,
            handle.frozen,
        )
        experiment = (operation.experiment, operation.partner, operation.handed)
        hand = (operation.state, handle.dead_man, handle.pressed, handle.pressed_by_person, reason)
        present = (*hand, operation.held, test, *experiment, answered, commanded, *robot)
        if present == self._told and now_ns < self._anew_ns:
            return None
        self._told, self._anew_ns = present, now_ns + _ANEW_NS
        capabilities, calibration = operation.capabilities, operation.calibration
        found = capabilities if calibration is None else calibration
        return JoystickStatus(
            state=operation.state,
            reason=reason[:MOST_CHARACTERS],
            dead_man=handle.dead_man,
            force_limit_n=handle.force_limit_n,
            device=capabilities.name[:MOST_CHARACTERS],
            half_width_m=found.half_width_m,
            half_height_m=found.half_height_m,
            answered=answered,
            refusal=refusal,
            commanded=commanded,
            command_refusal=command_refusal,
            temperature_c=operation.reading.temperature_c,
            x_m=handle.x_m,
            y_m=handle.y_m,
            pressed=handle.pressed,
            robot_waits=handle.robot_waits,
            robot_stopped=handle.robot_stopped,
            drive=handle.drive,
            blind=handle.blind,
            frozen=handle.frozen,
            held=operation.held or (handle.guest is not None and handle.guest.drives),
            person=handle.pressed_by_person,
            request=operation.due_request,
            command_age_ms=handle.command_age_ms,
            presses_n=round(handle.presses_n, 1),
            axes=tuple(
                AxisStatus(
                    name=axis.capabilities.name,
                    position=axis.position_m / axis.lever_m,
                    half_range=axis.capabilities.half_range,
                    force=axis.cut_n * axis.lever_m,
                    force_limit=axis.capabilities.force_limit,
                    unit=axis.capabilities.unit,
                )
                for axis in handle.more
            ),
            test=test.outcome.value,
            test_part=test.part.value,
            test_reason=test.reason[:MOST_CHARACTERS],
            test_number=test.number,
            test_metrics={figure.name: figure.value for figure in test.metrics},
            experiment=operation.experiment,
            partner=operation.partner,
            handed=operation.handed,
        )
