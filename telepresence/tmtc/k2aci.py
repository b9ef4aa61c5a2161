"""K2ACI: what experimenter, robot application and cosmonaut tell each other about a task.

A body is one CBOR array (RFC 8949) in deterministic encoding (clause 4.2.1), without tags and
without floating point. Private PUS messages carry it (`telepresence.tmtc.pus`).

| body | array |
|---|---|
| a message | kind, life, number, oldest, then the message's fields in their order |
| its acknowledgement | 0, life, number |

Kinds: 1 `TaskSelected`, 2 `StartTask`, 3 `TaskFinished`, 4 `PanelState`, 5 `Chat`,
6 `TaskProgress`. `boot_id` grows with each start. `number` counts its messages from 0.
`oldest` is the smallest number that the sender still repeats: the receiver waits for no number
below it.
"""

from collections import deque
from dataclasses import MISSING, dataclass, field, fields
from enum import EnumType, StrEnum
from typing import Any, NamedTuple, cast, get_args

import cbor2

from kontur_av.clock import NS_PER_MS
from kontur_av.errors import ConfigError, ProtocolError
from telepresence.tmtc.retransmission import Retransmission

#: A body with a private service's headers and its check fits in a packet of 256 octets.
MAX_BODY_OCTETS = 232
MAX_NAME_OCTETS = 32
MAX_TEXT_OCTETS = 128
MAX_CHAT_OCTETS = 200

_MOST = (1 << 32) - 1
_ACK = 0
_MOST_WAITING = 64
#: Messages under way at once.
_MOST_OPEN = 4
_MOST_ANSWERS = 16


class TaskResult(StrEnum):
    """How a run of a task ended."""

    FINISHED = "finished"
    ABORTED = "aborted"
    TIMED_OUT = "timed_out"
    LOST_SIGNAL = "lost_signal"


class PanelMode(StrEnum):
    """The states of the mission control panel."""

    NO_CONTACT = "no_contact"
    WAIT_TASK = "wait_task"
    TASK_INFO = "task_info"
    MOVE_TO_START = "move_to_start"
    HOLD = "hold"
    PRESS_DEADMAN = "press_deadman"
    RUNNING = "running"
    FINISHED = "finished"
    ERROR = "error"


class TaskGoal(StrEnum):
    """What the cosmonaut has to do now. circle, eight: paths of a spot."""

    START = "start"
    REACH = "reach"
    CIRCLE = "circle"
    EIGHT = "eight"
    CONTOUR = "contour"
    LINE = "line"
    SPRING = "spring"
    HANDS = "hands"
    BALL = "ball"
    FREE = "free"


class ChatRole(StrEnum):
    """Who writes in the chat."""

    COSMONAUT = "cosmonaut"
    EXPERIMENTER = "experimenter"
    SUPERVISOR = "supervisor"
    OPERATOR = "operator"


def _text(least: int, most: int, default: Any = MISSING) -> Any:
    """A field with one printable line of so many octets of UTF-8."""
    return field(default=default, metadata={"octets": (least, most)})


@dataclass(frozen=True, slots=True)
class _Checked:
    """Its fields are checked when it is made. ConfigError.

    A subclass with more checks names this class, because `super()` fails in a class with slots.
    """

    def __post_init__(self) -> None:
        for one in fields(self):
            value, kind = getattr(self, one.name), cast(Any, one.type)
            if kind is int:
                _check_count(one.name, value)
            elif kind is str:
                _check_text(one.name, value, *one.metadata["octets"])
            elif kind == tuple[int, int]:
                _check_place(one.name, value)
            elif isinstance(kind, EnumType) and type(value) is not kind:
                raise ConfigError(f"{one.name} is {value!r}: choose one of {', '.join(kind)}")


@dataclass(frozen=True, slots=True, kw_only=True)
class TaskSelected(_Checked):
    """To the panel: the robot is ready for this task.

    task: its name. run: its number in the session. start_um: where the handle begins, (x, y) in
    micrometres from the centre of the workspace. text: instructions, one line, may be empty.
    """

    task: str = _text(1, MAX_NAME_OCTETS)
    run: int
    start_um: tuple[int, int] = (0, 0)
    text: str = _text(0, MAX_TEXT_OCTETS, default="")


@dataclass(frozen=True, slots=True, kw_only=True)
class StartTask(_Checked):
    """To the robot: the cosmonaut holds the start position with the dead-man pressed."""

    task: str = _text(1, MAX_NAME_OCTETS)
    run: int


@dataclass(frozen=True, slots=True, kw_only=True)
class TaskFinished(_Checked):
    """To the panel: the run has ended.

    duration_ms: since its start; 0 if it never started. reason: why it did not finish, or how well
    it was done.
    """

    task: str = _text(1, MAX_NAME_OCTETS)
    run: int
    result: TaskResult
    duration_ms: int = 0
    reason: str = _text(0, MAX_TEXT_OCTETS, default="")


@dataclass(frozen=True, slots=True, kw_only=True)
class PanelState(_Checked):
    """To the ground: what the panel shows.

    task and run: "" and 0 while there is none. reason: why the panel ended the run.
    """

    mode: PanelMode
    task: str = _text(0, MAX_NAME_OCTETS, default="")
    run: int = 0
    reason: str = _text(0, MAX_TEXT_OCTETS, default="")


@dataclass(frozen=True, slots=True, kw_only=True)
class Chat(_Checked):
    """One line of chat, at most 200 octets of UTF-8."""

    sender: ChatRole
    text: str = _text(1, MAX_CHAT_OCTETS)


@dataclass(frozen=True, slots=True, kw_only=True)
class TaskProgress(_Checked):
    """To the panel: what has to be done now, and how far it is. Sent at each change.

    step, steps: this goal is one of so many. position_um: of what is to be reached, of the hand
    that is to be met, or of the ball. percent: of a curve. force_mn: with which to pull or push.
    turn_ms: of the spot. hold_ms: how long the condition must hold; held_ms: how long it has, 0
    while it does not. left_ms: until the run ends. Of what a goal does not have, 0.
    """

    run: int
    goal: TaskGoal
    step: int = 1
    steps: int = 1
    position_um: tuple[int, int] = (0, 0)
    percent: int = 0
    force_mn: int = 0
    turn_ms: int = 0
    hold_ms: int = 0
    held_ms: int = 0
    left_ms: int = 0

    def __post_init__(self) -> None:
        _Checked.__post_init__(self)
        if self.turn_ms == 0 and self.goal in (TaskGoal.CIRCLE, TaskGoal.EIGHT):
            raise ConfigError("turn_ms is 0: a spot needs the time of a turn")


#: A class's place is its kind on the wire, from 1.
K2aciMessage = TaskSelected | StartTask | TaskFinished | PanelState | Chat | TaskProgress
CLASSES: tuple[type[K2aciMessage], ...] = get_args(K2aciMessage)


@dataclass(frozen=True, slots=True)
class Numbered(_Checked):
    """A message as it is sent. boot_id, number, oldest: as in the module's table."""

    boot_id: int
    number: int
    oldest: int
    message: K2aciMessage

    def __post_init__(self) -> None:
        _Checked.__post_init__(self)
        if self.oldest > self.number:
            raise ConfigError(f"oldest {self.oldest} is above the number {self.number}")


@dataclass(frozen=True, slots=True)
class Acknowledgement(_Checked):
    """The message `number` of `boot_id` has been handed to the application."""

    boot_id: int
    number: int


def pack_body(body: Numbered | Acknowledgement) -> bytes:
    """Return `body` as CBOR. The texts of all classes are so short that it fits in a packet."""
    if isinstance(body, Acknowledgement):
        return cbor2.dumps([_ACK, body.boot_id, body.number], canonical=True)
    message = body.message
    values = [_plain(getattr(message, one.name)) for one in fields(message)]
    kind = CLASSES.index(type(message)) + 1
    return cbor2.dumps([kind, body.boot_id, body.number, body.oldest, *values], canonical=True)


def parse_body(octets: bytes) -> Numbered | Acknowledgement:
    """Return the message or acknowledgement in `octets`; ProtocolError if there is none."""
    if not 0 < len(octets) <= MAX_BODY_OCTETS:
        raise ProtocolError(f"K2ACI: {len(octets)} octets, not 1 to {MAX_BODY_OCTETS}")
    values = _parse_array(octets)
    try:
        return _build(values)
    except ConfigError as error:
        raise ProtocolError(f"K2ACI: {error}") from error


def _parse_array(octets: bytes) -> list[Any]:
    try:
        values = cbor2.loads(octets, max_depth=2, allow_indefinite=False)
        if type(values) is not list or not all(map(_is_plain, values)):
            raise ProtocolError("K2ACI: no array of integers, texts and pairs")
        if cbor2.dumps(values, canonical=True) != octets:
            raise ProtocolError("K2ACI: not in deterministic encoding")
    except cbor2.CBORError as error:
        raise ProtocolError(f"K2ACI: no CBOR: {type(error).__name__}") from error
    return values


def _is_plain(value: object) -> bool:
    if type(value) is list:
        return len(value) == 2 and all(type(item) is int for item in value)
    return type(value) is int or type(value) is str


def _build(values: list[Any]) -> Numbered | Acknowledgement:
    kind = values[0] if values else None
    if kind == _ACK and len(values) == 3:
        return Acknowledgement(values[1], values[2])
    if type(kind) is not int or not 1 <= kind <= len(CLASSES):
        raise ProtocolError(f"K2ACI: unknown kind {kind!r}")
    cls = CLASSES[kind - 1]
    known = fields(cls)
    if len(values) != 4 + len(known):
        raise ProtocolError(f"K2ACI: {cls.__name__} with {len(values)} values")
    given = {
        one.name: _typed(one.type, value) for one, value in zip(known, values[4:], strict=True)
    }
    return Numbered(values[1], values[2], values[3], cls(**given))


def _plain(value: object) -> object:
    if isinstance(value, tuple):
        return list(value)
    return str(value) if isinstance(value, StrEnum) else value


def _typed(kind: Any, value: Any) -> Any:
    if type(value) is list:
        return tuple(value)
    return kind(value) if isinstance(kind, EnumType) and value in set(kind) else value


def fitted_line(text: str) -> str:
    """Return `text` as one printable line of at most `MAX_TEXT_OCTETS` of UTF-8."""
    line = "".join(sign if sign.isprintable() else " " for sign in text)
    return line.encode()[:MAX_TEXT_OCTETS].decode(errors="ignore")


def _check_text(name: str, value: object, least: int, most: int) -> None:
    if type(value) is not str or not value.isprintable():
        raise ConfigError(f"{name} is {value!r}: give one line of printable text")
    if not least <= len(value.encode()) <= most:
        raise ConfigError(f"{name} has {len(value.encode())} octets: give {least} to {most}")


def _check_place(name: str, value: object) -> None:
    if type(value) is not tuple or len(value) != 2:
        raise ConfigError(f"{name} is {value!r}: give two integers")
    for one in value:
        if type(one) is not int or abs(one) > 1_000_000:
            raise ConfigError(f"{name} has {one!r}: give micrometres up to ±1000000")


def _check_count(name: str, value: object) -> None:
    if type(value) is not int or not 0 <= value <= _MOST:
        raise ConfigError(f"{name} is {value!r}: give an integer from 0 to {_MOST}")


class Arrived(NamedTuple):
    """A message of the peer, once and in order. number: the peer's, in this `boot_id` of it."""

    boot_id: int
    number: int
    message: K2aciMessage


class Delivered(NamedTuple):
    """The peer's application has the message that `send` gave this number."""

    number: int
    message: K2aciMessage
    round_trip_ns: int


class K2aciEndpoint:
    """One end of K2ACI: repeats messages until they are acknowledged, drops repetitions. A core.

    After `send`, `handle_message` and `handle_contact`, send what `poll_transmit` returns until it
    is None, and drain `next_event`. Call `poll_transmit` again at `poll_timeout`.

    Messages reach the peer's application once and in the order of `send`, also over a path that
    loses, repeats or delays packets for minutes. Four messages are under way at once; 64 may
    wait. Each repetition of a message waits twice as long as the one before, up to 8 `timeout_ns`.
    If the receiving process is killed, the last messages may arrive again under their numbers.

    boot_id: grows with each start, for example the second of that instant; 0 to 2^32 - 1.
    Raises ConfigError for a life out of range or a timeout that is not positive.
    """

    def __init__(self, *, boot_id: int, timeout_ns: int = 500 * NS_PER_MS) -> None:
        _check_count("boot_id", boot_id)
        if timeout_ns <= 0:
            raise ConfigError("K2ACI needs a timeout above 0")
        self.arrived = 0
        self.duplicates = 0
        self.garbage = 0
        #: Acknowledgements of what is not open, and messages of an earlier start or out of reach.
        self.unexpected = 0
        self.dropped_answers = 0
        self._boot_id = boot_id
        self._sending: Retransmission[K2aciMessage] = Retransmission(
            timeout_ns=timeout_ns, most=_MOST_WAITING, window=_MOST_OPEN
        )
        self._answers: deque[Acknowledgement] = deque()
        self._peer_boot_id = -1
        self._expected = 0
        self._held: dict[int, K2aciMessage] = {}
        self._events: deque[Arrived | Delivered] = deque()

    @property
    def sent(self) -> int:
        """Messages sent, with their repetitions."""
        return self._sending.sent

    @property
    def repeated(self) -> int:
        """Messages sent again."""
        return self._sending.repeated

    @property
    def waiting(self) -> tuple[int, ...]:
        """The numbers of the messages that are not acknowledged yet, oldest first."""
        return self._sending.numbers

    def send(self, message: K2aciMessage, now_ns: int) -> int | None:
        """Give `message` to the peer; return its number, or None while 64 wait already."""
        if self._sending.full:
            return None
        return self._sending.handle_put(message, now_ns)

    def handle_contact(self, now_ns: int) -> None:
        """The signal is acquired: repeat at once what is open."""
        self._sending.handle_contact(now_ns)

    def handle_message(self, octets: bytes, now_ns: int) -> None:
        """A body arrived. Garbage is counted; this never raises."""
        try:
            body = parse_body(octets)
        except ProtocolError:
            self.garbage += 1
            return
        if isinstance(body, Acknowledgement):
            self._handle_acknowledgement(body, now_ns)
        else:
            self._handle_numbered(body)

    def _handle_acknowledgement(self, body: Acknowledgement, now_ns: int) -> None:
        sending = self._sending.get(body.number) if body.boot_id == self._boot_id else None
        if sending is None:
            self.unexpected += 1
            return
        self._sending.pop(body.number)
        self._events.append(Delivered(body.number, sending.item, now_ns - sending.first_ns))

    def _handle_numbered(self, body: Numbered) -> None:
        if body.boot_id > self._peer_boot_id:
            self._peer_boot_id = body.boot_id
            self._expected = body.oldest
            self._held.clear()
        elif body.boot_id < self._peer_boot_id:
            self.unexpected += 1
            return
        if body.number < self._expected:
            self.duplicates += 1
            self._answer(body.number)
            return
        self._expected = max(self._expected, body.oldest)
        if body.number - self._expected >= _MOST_WAITING:
            self.unexpected += 1
            return
        self.duplicates += body.number in self._held
        self._held[body.number] = body.message
        self._held = {key: value for key, value in self._held.items() if key >= self._expected}
        while (message := self._held.pop(self._expected, None)) is not None:
            self.arrived += 1
            self._events.append(Arrived(self._peer_boot_id, self._expected, message))
            self._answer(self._expected)
            self._expected += 1

    def _answer(self, number: int) -> None:
        # A lost answer is asked for again, so the oldest may go.
        if len(self._answers) == _MOST_ANSWERS:
            self._answers.popleft()
            self.dropped_answers += 1
        self._answers.append(Acknowledgement(self._peer_boot_id, number))

    def poll_transmit(self, now_ns: int) -> bytes | None:
        """Return the next body to send, acknowledgements first, or None."""
        if self._answers:
            return pack_body(self._answers.popleft())
        due = self._sending.poll_transmit(now_ns)
        if due is None:
            return None
        number, sending = due
        return pack_body(Numbered(self._boot_id, number, self._sending.numbers[0], sending.item))

    def poll_timeout(self) -> int | None:
        """When `poll_transmit` has something to repeat; None while nothing is open."""
        return self._sending.poll_timeout()

    def next_event(self) -> Arrived | Delivered | None:
        """The oldest event that was not fetched yet, or None."""
        return self._events.popleft() if self._events else None
