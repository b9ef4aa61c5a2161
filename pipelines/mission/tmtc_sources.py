"""Where the parameters of joystick, robot and gateways come from, and how the two are told.

The situation of an end is told for each of its people: by joystick and robot.

| application | parameters from | functions |
|---|---|---|
| joystick | `joystick/state` | requests on `joystick/command`, answered in `joystick/state` |
| robot | `robot/state`, `robot/status` | commands on `robot/command`, answered in `robot/status` |
| gateways | `link_state/…` | |
"""

from collections import OrderedDict
from math import nan

from kontur_av.clock import NS_PER_MS, NS_PER_S
from pipelines.hand.hand_topics import HandRequest, JoystickStatus
from pipelines.hand.knowledge import EndKnowledge
from pipelines.mission.mission_metrics import SituationMetrics
from pipelines.mission.tmtc import TmtcEnd
from pipelines.mission.tmtc_messages import FunctionAsked, FunctionDone, Values
from pipelines.session.access import PEOPLE, Role
from pipelines.session.mission_messages import RobotCommand, RobotStatus
from pipelines.session.setup.segments import Segment
from pipelines.session.situation import Known, Terminal, Why, at_end, situation
from telepresence.haptics.device.functional_test import Outcome
from telepresence.haptics.device.states import REQUESTS, JoystickState
from telepresence.tasks.definitions import ControlMode
from telepresence.tasks.robot_control import Fault
from telepresence.world import WorldState

#: How often parameters are taken over, and their limits checked.
SAMPLE_NS = 500 * NS_PER_MS

_EVENTS = {event.value: event for event in REQUESTS}
#: In these states the joystick does not do what it is there for.
_OFF_NOMINAL = (
    JoystickState.HALTED,
    JoystickState.CALIBRATION_ERROR,
    JoystickState.RECOVERABLE,
    JoystickState.FATAL,
)
_MOST_ASKED = 16
#: The dictionary has parameters for this many.
MOST_JOINTS = 7
#: The size of the parameter `error` of the robot.
_ERROR_CHARACTERS = 64


class GatewaySource:
    """Takes a gateway's parameters over, and reports when the signal comes and goes."""

    def __init__(self, end: TmtcEnd, application: str) -> None:
        self._end, self._application = end, application
        self._signal: bool | None = None

    def handle_values(self, values: Values, now_ns: int) -> None:
        signal = bool(values.get("signal"))
        self._end.handle_values(self._application, values, now_ns)
        if self._signal is not None and signal != self._signal:
            event = "signal_acquired" if signal else "signal_lost"
            self._end.handle_event(self._application, event, now_ns)
        self._signal = signal
        self._end.handle_signal(signal, now_ns)


class _Asked:
    """Functions that wait for their results, by the numbers of their requests.

    first_number: above those of an earlier start, for example the instant at which this one began.
    """

    def __init__(self, application: str, end: TmtcEnd, *, first_number: int) -> None:
        self._application, self._end = application, end
        self._number = first_number
        self._tokens: OrderedDict[int, int | None] = OrderedDict()

    def handle_asked(self, asked: FunctionAsked) -> int:
        """Return the number of its request."""
        self._number += 1
        if len(self._tokens) == _MOST_ASKED:
            self._tokens.popitem(last=False)
        self._tokens[self._number] = asked.token
        return self._number

    def handle_answer(self, number: int | None, refusal: str, now_ns: int) -> None:
        """A request was carried out or refused; one that is not known changes nothing."""
        if number is not None and number in self._tokens:
            done = FunctionDone(self._application, self._tokens.pop(number), refusal)
            self._end.handle_request(done, now_ns)


class RobotSource:
    """Takes the robot over, and hands it the functions that telecommands ask for.

    first_number: as `JoystickSource` has it.
    """

    def __init__(self, end: TmtcEnd, *, first_number: int) -> None:
        self._end = end
        self._asked = _Asked("robot", end, first_number=first_number)
        self._functions = {function.name for function in end.applications["robot"].table.functions}
        self._next_ns = 0
        self._known: tuple[object, ...] = ()
        self._known_ns = 0
        self._faults: tuple[int, int] | None = None

    def handle_state(self, state: WorldState, now_ns: int) -> None:
        """The newest state of the robot; taken over at most twice a second."""
        if now_ns < self._next_ns:
            return
        self._next_ns = now_ns + SAMPLE_NS
        values: Values = {
            "x": state.x_m,
            "y": state.y_m,
            "force": state.force_n,
            "contact": state.contact,
        }
        self._end.handle_values("robot", values, now_ns)

    def handle_asked(self, asked: FunctionAsked, _now_ns: int) -> RobotCommand | None:
        """Return the command for the robot, or None, if it is for another part."""
        if asked.application != "robot" or asked.function not in self._functions:
            return None
        number = self._asked.handle_asked(asked)
        if not asked.arguments:
            return RobotCommand(number, asked.function)
        # The dictionary has let only its choices pass.
        return RobotCommand(number, asked.function, ControlMode(str(asked.arguments[0])))

    def handle_status(self, status: RobotStatus, now_ns: int) -> None:
        """What the robot controller does. A new fault is an event."""
        values: Values = {
            "powered": status.powered,
            "mode": status.mode,
            "error": _error(status),
            "error_kind": status.error,
            "hold": status.hold or "none",
            "partner": status.partner,
            "offset_x": status.offset_mm[0],
            "offset_y": status.offset_mm[1],
        }
        known = tuple(values.values())
        if known != self._known or now_ns >= self._known_ns:
            self._known, self._known_ns = known, now_ns + SAMPLE_NS
            values |= _joints(status) | status.fields
            if status.partner_seen is not None:
                x_m, y_m, force_n, contact, age_ms = status.partner_seen
                values |= {"partner_x": x_m, "partner_y": y_m, "partner_force": force_n}
                values |= {"partner_contact": contact, "partner_age": age_ms}
            for name, place, force in status.axes:
                values |= {name: place, f"{name}_force": force}
            self._end.handle_values("robot", values, now_ns)
        faults = (status.boot_id, status.faults)
        if status.faults and faults != self._faults:
            self._end.handle_event("robot", "error", now_ns)
        self._faults = faults
        self._asked.handle_answer(status.commanded, status.command_refusal, now_ns)


def _joints(status: RobotStatus) -> Values:
    """Angle and torque of each joint; no number where the robot has or tells none."""
    values: Values = {}
    unknown = ((nan, nan),) * MOST_JOINTS
    for number, (angle_rad, torque_n_m) in enumerate((*status.joints, *unknown)[:MOST_JOINTS], 1):
        values[f"joint_{number}_angle"] = angle_rad
        values[f"joint_{number}_torque"] = torque_n_m
    return values


def _error(status: RobotStatus) -> str:
    """The limit that was broken; of another fault the robot's own words, as far as they fit."""
    words = status.fault.encode("ascii", "replace").decode()[:_ERROR_CHARACTERS]
    return words if status.error == Fault.OTHER and words else status.error


class JoystickSource:
    """Takes the state of the joystick over, and hands it the functions that telecommands ask for.

    first_number: above those of an earlier start, for example the instant at which this one began.
    """

    def __init__(self, end: TmtcEnd, *, first_number: int) -> None:
        self._end = end
        self._state: JoystickState | None = None
        self._test: tuple[int, str] | None = None
        self._next_ns = 0
        self._asked = _Asked("joystick", end, first_number=first_number)

    def handle_asked(self, asked: FunctionAsked, now_ns: int) -> HandRequest | None:
        """Return the request for the joystick, or None, if it is for another part."""
        event = _EVENTS.get(asked.function)
        if asked.application != "joystick" or event is None:
            return None
        return HandRequest(self._asked.handle_asked(asked), event)

    def handle_status(self, status: JoystickStatus, now_ns: int) -> None:
        """The newest state of the joystick."""
        state = JoystickState(status.state)
        changed = self._state is not None and state is not self._state
        test = (status.test_number, status.test)
        tested = self._test is not None and test != self._test
        self._test = test
        if changed or tested or now_ns >= self._next_ns:
            self._next_ns = now_ns + SAMPLE_NS
            temperature_c = nan if status.temperature_c is None else status.temperature_c
            values: Values = {
                "state": state.words,
                "application": _application(status, state),
                "dead_man": status.dead_man,
                "force_limit": status.force_limit_n,
                "temperature": temperature_c,
                "x": status.x_m,
                "y": status.y_m,
                "test": status.test,
                "test_part": status.test_part,
                **self._measured(status),
            }
            self._end.handle_values("joystick", values, now_ns)
        if changed:
            self._end.handle_event("joystick", "state_changed", now_ns)
            if state in _OFF_NOMINAL:
                self._end.handle_event("joystick", "off_nominal", now_ns)
        if tested and status.test != Outcome.RUNNING:
            passed = status.test == Outcome.PASSED
            event = "test_passed" if passed else "test_failed"
            self._end.handle_event("joystick", event, now_ns)
            if status.test_metrics:
                self._end.handle_event("joystick", "test_measured", now_ns)
        self._state = state
        self._asked.handle_answer(status.commanded, status.command_refusal, now_ns)

    def _measured(self, status: JoystickStatus) -> Values:
        """What the newest functional test measured; no number for what it did not."""
        table = self._end.applications["joystick"].table
        found = {
            f"test_{name.replace(' ', '_')}": nan if value is None else value
            for name, value in status.test_metrics.items()
        }
        pressed = [value for name, value in found.items() if name.endswith("_let_go")]
        if pressed:
            found["test_buttons"] = sum(pressed)
        return {name: found.get(name, nan) for name in table.structure("test_figures").parameters}


def _application(status: JoystickStatus, state: JoystickState) -> str:
    if status.test == Outcome.RUNNING:
        return "joystick test"
    return status.experiment if state is JoystickState.APPLICATION else "none"


#: A reason is an event once it has held for so long, and at most so often.
_STEADY_NS, _EVENT_NS = NS_PER_S, 2 * NS_PER_S


class SituationSource:
    """Tells why the hand may not move the robot at an end, and what each of its people does next.

    connected: the caller sets whether the radio link is.
    """

    def __init__(self, end: TmtcEnd, knowledge: EndKnowledge, segment: Segment) -> None:
        self._end, self._knowledge, self._segment = end, knowledge, segment
        self._application = "joystick" if segment is Segment.SPACE else "robot"
        self.connected = False
        self._due_ns = self._event_ns = 0
        #: The newest reason with its instant, and the one that was an event.
        self._why: tuple[Why, int] | None = None
        self._told: Why | None = None

    def known(self, now_ns: int, role: Role = Role.OPERATOR) -> Known:
        """What this end knows, for a role."""
        return self._knowledge.known(role, now_ns, connected=self.connected)

    def report(self, now_ns: int, terminal: Terminal) -> SituationMetrics:
        """What a terminal on this end's machine says."""
        told = at_end(self.known(now_ns), terminal)
        return SituationMetrics(situation=told.why, reason=told.reason, advice=told.advice)

    def handle_time(self, now_ns: int) -> None:
        """Twice a second the parameters; an event when another reason lasts."""
        if now_ns < self._due_ns:
            return
        self._due_ns = now_ns + SAMPLE_NS
        told = {role: situation(self.known(now_ns, role)) for role in PEOPLE[self._segment]}
        why = next(iter(told.values())).why
        values: Values = {"situation": why.value}
        values |= {f"next_{role.value}": each.next.value for role, each in told.items()}
        self._end.handle_values(self._application, values, now_ns)
        # A hand that presses and lets go changes nothing.
        why = Why.READY if why in (Why.FOLLOWS, Why.PRESS) else why
        if self._why is None or self._why[0] is not why:
            self._why = why, now_ns
        if self._told is None:
            self._told = why
        lasts = now_ns - self._why[1] >= _STEADY_NS and now_ns >= self._event_ns
        if lasts and why is not self._told:
            self._told, self._event_ns = why, now_ns + _EVENT_NS
            self._end.handle_event(self._application, "situation_changed", now_ns)
