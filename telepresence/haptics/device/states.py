"""The states of the joystick, and which event leads from which to which: nothing else does.

States and errors as the Kontur-2 joystick has them (C. Riecke et al., "Kontur-2 mission: the DLR
force feedback joystick for space telemanipulation from the ISS", i-SAIRAS 2016); the table of
transitions is this project's own. A state's number travels in octet 3 of each command sample.

Force is given in `APPLICATION` only, and by the calibration in `STANDBY`. `FATAL` is final: what
leads out of it is a new start of the process, which begins with the self-test.
"""

from collections import deque
from collections.abc import Mapping
from enum import Enum, IntEnum
from types import MappingProxyType
from typing import NamedTuple


class State(IntEnum):
    """What the joystick is in; the number is the one that is sent."""

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
        """The state in a sentence: "standby", "calibration error"."""
        return _WORDS[self]


_WORDS = {
    State.INIT: "init",
    State.STANDBY: "standby",
    State.CALIBRATED: "calibrated",
    State.APPLICATION: "application",
    State.HALTED: "halted",
    State.CALIBRATION_ERROR: "calibration error",
    State.RECOVERABLE: "recoverable error",
    State.FATAL: "fatal error",
}


class Event(Enum):
    """What may happen: requests of a person first, then what the joystick finds by itself."""

    CALIBRATE = "calibrate"
    START = "start"
    STOP = "stop"
    HALT = "halt"
    RESUME = "resume"
    ACKNOWLEDGE = "acknowledge"

    SELF_TEST_PASSED = "self-test passed"
    CALIBRATION_PASSED = "calibration passed"
    CALIBRATION_FAILED = "calibration failed"
    FAULT = "fault"
    FATAL_FAULT = "fatal fault"


#: What a person may ask for; all else is found by the joystick itself.
REQUESTS = frozenset(
    {Event.CALIBRATE, Event.START, Event.STOP, Event.HALT, Event.RESUME, Event.ACKNOWLEDGE}
)


def _table() -> dict[tuple[State, Event], State]:
    s, e = State, Event
    table = {
        (s.INIT, e.SELF_TEST_PASSED): s.STANDBY,
        # While it calibrates it stays in standby: what it reads is no position yet.
        (s.STANDBY, e.CALIBRATE): s.STANDBY,
        (s.STANDBY, e.CALIBRATION_PASSED): s.CALIBRATED,
        (s.STANDBY, e.CALIBRATION_FAILED): s.CALIBRATION_ERROR,
        (s.CALIBRATED, e.START): s.APPLICATION,
        (s.CALIBRATED, e.CALIBRATE): s.STANDBY,
        (s.CALIBRATED, e.HALT): s.HALTED,
        (s.APPLICATION, e.STOP): s.CALIBRATED,
        (s.APPLICATION, e.HALT): s.HALTED,
        # Never straight back into the application: force comes after a request for it.
        (s.HALTED, e.RESUME): s.CALIBRATED,
        (s.CALIBRATION_ERROR, e.CALIBRATE): s.STANDBY,
        (s.CALIBRATION_ERROR, e.ACKNOWLEDGE): s.STANDBY,
        # A sensor that was wrong once is calibrated anew before it is believed.
        (s.RECOVERABLE, e.ACKNOWLEDGE): s.STANDBY,
    }
    for state in State:
        if state is not State.FATAL:
            table[state, e.FATAL_FAULT] = s.FATAL
    for state in (s.INIT, s.STANDBY, s.CALIBRATED, s.APPLICATION, s.HALTED, s.CALIBRATION_ERROR):
        table[state, e.FAULT] = s.RECOVERABLE
    return table


#: Where each event leads from each state; what is not in it is refused.
TRANSITIONS: Mapping[tuple[State, Event], State] = MappingProxyType(_table())


class Transition(NamedTuple):
    """The state `before`, and `after`, the event at `now_ns`; reason: one line, may be empty."""

    now_ns: int
    before: State
    event: Event
    after: State
    reason: str


class StateMachine:
    """Where the joystick stands, and how it came there.

    state; since_ns: when it was entered; reason: why, in one line, "" if that needs no words.
    entered: how many transitions there were. refused: events that the table does not have.
    `next_event` gives the transitions; of 64 that nobody fetches the oldest go.
    """

    def __init__(self, now_ns: int = 0) -> None:
        self.state = State.INIT
        self.since_ns = now_ns
        self.reason = ""
        self.entered = 0
        self.refused = 0
        self._transitions: deque[Transition] = deque(maxlen=64)

    def handle_event(self, event: Event, now_ns: int, reason: str = "") -> str:
        """Go where `event` leads: "" if it was allowed, else one line that says why not."""
        after = TRANSITIONS.get((self.state, event))
        if after is None:
            self.refused += 1
            return self._refusal(event)
        self._transitions.append(Transition(now_ns, self.state, event, after, reason))
        self.entered += 1
        self.state, self.since_ns, self.reason = after, now_ns, reason
        return ""

    def next_event(self) -> Transition | None:
        """The next transition, or None."""
        return self._transitions.popleft() if self._transitions else None

    def _refusal(self, event: Event) -> str:
        state = self.state
        if state is State.FATAL:
            why = f": {self.reason}" if self.reason else ""
            return f"{event.value}: refused after a fatal error{why}; start the process anew"
        allowed = [other.value for (at, other) in TRANSITIONS if at is state and other in REQUESTS]
        offer = f"allowed there: {', '.join(allowed)}" if allowed else "nothing can be asked there"
        return f"{event.value}: not in the state {state.words}; {offer}"
