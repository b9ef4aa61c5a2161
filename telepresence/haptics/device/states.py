"""The states of the joystick, and the table of all allowed transitions.

The states and errors are those of the Kontur-2 joystick (C. Riecke et al., "Kontur-2 mission: the
DLR force feedback joystick for space telemanipulation from the ISS", i-SAIRAS 2016). The table of
transitions is this project's own.

There is force only in `APPLICATION`, during the calibration in `STANDBY`, and during the functional
test in `CALIBRATED`. `FATAL` is final: only a restart of the process leaves it, and that begins
with the self-test.
"""

from collections import deque
from collections.abc import Mapping
from enum import Enum, IntEnum, StrEnum
from types import MappingProxyType
from typing import NamedTuple


class JoystickState(IntEnum):
    """The state of the joystick; its number is sent in samples."""

    INIT = 0
    STANDBY = 1
    CALIBRATED = 2
    APPLICATION = 3
    HALTED = 4
    CALIBRATION_ERROR = 5
    RECOVERABLE = 6
    FATAL = 7

    @property
    def words(self) -> str:
        """The state in words, such as "calibration error"."""
        error = " error" if self in (JoystickState.RECOVERABLE, JoystickState.FATAL) else ""
        return self.name.replace("_", " ").lower() + error


class ExperimentName(StrEnum):
    """Whose robot the application drives: ours, or the partner's. Words of the telemetry."""

    GERMAN = "german experiment"
    RUSSIAN = "russian experiment"


class JoystickEvent(Enum):
    """What can happen: requests of a person first, then what the joystick itself detects."""

    CALIBRATE = "calibrate"
    START = "start"
    STOP = "stop"
    HALT = "halt"
    RESUME = "resume"
    ACKNOWLEDGE = "acknowledge"
    TEST = "test"
    #: Chooses the experiment, then is a `START`: no transition of its own.
    START_RUSSIAN = "start_russian"
    #: Hand the handle over to a policy, and back to a person: no transitions either.
    POLICY = "policy"
    PERSON = "person"

    SELF_TEST_PASSED = "self-test passed"
    CALIBRATION_PASSED = "calibration passed"
    CALIBRATION_FAILED = "calibration failed"
    TEST_PASSED = "test passed"
    TEST_FAILED = "test failed"
    FAULT = "fault"
    FATAL_FAULT = "fatal fault"


#: What a person may request; the joystick itself detects everything else.
REQUESTS = frozenset(
    {
        JoystickEvent.CALIBRATE,
        JoystickEvent.START,
        JoystickEvent.STOP,
        JoystickEvent.HALT,
        JoystickEvent.RESUME,
        JoystickEvent.ACKNOWLEDGE,
        JoystickEvent.TEST,
        JoystickEvent.START_RUSSIAN,
        JoystickEvent.POLICY,
        JoystickEvent.PERSON,
    }
)


def _table() -> dict[tuple[JoystickState, JoystickEvent], JoystickState]:
    s, e = JoystickState, JoystickEvent
    table = {
        (s.INIT, e.SELF_TEST_PASSED): s.STANDBY,
        # It stays in standby while it calibrates, because its readings are no positions yet.
        (s.STANDBY, e.CALIBRATE): s.STANDBY,
        (s.STANDBY, e.CALIBRATION_PASSED): s.CALIBRATED,
        (s.STANDBY, e.CALIBRATION_FAILED): s.CALIBRATION_ERROR,
        (s.CALIBRATED, e.START): s.APPLICATION,
        (s.CALIBRATED, e.CALIBRATE): s.STANDBY,
        (s.CALIBRATED, e.HALT): s.HALTED,
        # It stays calibrated while it tests itself, so no robot follows it.
        (s.CALIBRATED, e.TEST): s.CALIBRATED,
        (s.CALIBRATED, e.TEST_PASSED): s.CALIBRATED,
        (s.CALIBRATED, e.TEST_FAILED): s.CALIBRATED,
        (s.APPLICATION, e.STOP): s.CALIBRATED,
        (s.APPLICATION, e.HALT): s.HALTED,
        # Never straight back into the application: force requires a request.
        (s.HALTED, e.RESUME): s.CALIBRATED,
        (s.CALIBRATION_ERROR, e.CALIBRATE): s.STANDBY,
        (s.CALIBRATION_ERROR, e.ACKNOWLEDGE): s.STANDBY,
        # After a sensor fault, calibrate again before the sensor is trusted.
        (s.RECOVERABLE, e.ACKNOWLEDGE): s.STANDBY,
    }
    for state in JoystickState:
        if state is not JoystickState.FATAL:
            table[state, e.FATAL_FAULT] = s.FATAL
    for state in (s.INIT, s.STANDBY, s.CALIBRATED, s.APPLICATION, s.HALTED, s.CALIBRATION_ERROR):
        table[state, e.FAULT] = s.RECOVERABLE
    return table


#: The next state for each state and event. Any other event is refused.
TRANSITIONS: Mapping[tuple[JoystickState, JoystickEvent], JoystickState] = MappingProxyType(
    _table()
)


class Transition(NamedTuple):
    """The step from state `before` to `after` at `now_ns`; reason: one line, may be empty."""

    now_ns: int
    before: JoystickState
    event: JoystickEvent
    after: JoystickState
    reason: str


class StateMachine:
    """The state of the joystick, and how it was reached.

    state: the present state. since_ns: when it was entered.
    reason: why it was entered, in one line; "" if there is nothing to say.
    entered: number of transitions. refused: events without an entry in the table.

    At most 64 transitions wait for `next_event`; beyond that the oldest is dropped.
    """

    def __init__(self, now_ns: int = 0) -> None:
        self.state = JoystickState.INIT
        self.since_ns = now_ns
        self.reason = ""
        self.entered = 0
        self.refused = 0
        self._transitions: deque[Transition] = deque(maxlen=64)

    def handle_event(self, event: JoystickEvent, now_ns: int, reason: str = "") -> str:
        """Take the transition for `event`; return "" or one line that says why it is refused."""
        after = TRANSITIONS.get((self.state, event))
        if after is None:
            self.refused += 1
            return self._refusal(event)
        self._transitions.append(Transition(now_ns, self.state, event, after, reason))
        self.entered += 1
        self.state, self.since_ns, self.reason = after, now_ns, reason
        return ""

    def next_event(self) -> Transition | None:
        """The oldest transition that was not fetched yet, or None."""
        return self._transitions.popleft() if self._transitions else None

    def _refusal(self, event: JoystickEvent) -> str:
        state = self.state
        if state is JoystickState.FATAL:
            why = f": {self.reason}" if self.reason else ""
            return f"{event.value}: refused after a fatal error{why}; restart the process"
        allowed = [other.value for (at, other) in TRANSITIONS if at is state and other in REQUESTS]
        offer = f"allowed there: {', '.join(allowed)}" if allowed else "no request is allowed there"
        return f"{event.value}: not in the state {state.words}; {offer}"
