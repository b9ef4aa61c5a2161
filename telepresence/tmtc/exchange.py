"""Telecommands over an unreliable path: the sender repeats, the receiver executes once.

The sender repeats a telecommand until it is acknowledged. The receiver recognizes repetitions,
executes the telecommand once, and acknowledges each copy.
"""

from collections import OrderedDict, deque
from dataclasses import dataclass

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ConfigError, ProtocolError
from telepresence.tmtc.packets import (
    Housekeeping,
    Message,
    SelectAck,
    SelectCamera,
    check_name,
    pack_packet,
    parse_packet,
)

_TOKEN_MODULUS = 1 << 16
_KNOWN_DEPTH = 64
_ANSWERS_DEPTH = 16


@dataclass(frozen=True, slots=True)
class SelectDone:
    """The telecommand was executed (`ok`) or refused. The camera `name` is selected now."""

    name: str
    token: int
    ok: bool
    round_trip_ns: int


@dataclass(frozen=True, slots=True)
class SelectFailed:
    """No acknowledgement after `tries`, or superseded by a later telecommand."""

    name: str
    token: int
    tries: int
    superseded: bool


@dataclass(slots=True)
class _Request:
    name: str
    token: int
    first_ns: int
    due_ns: int
    tries: int = 0


class TelecommandSender:
    """Repeats one telecommand until it is acknowledged; gives up after `tries`.

    After `select` and each `handle_packet`, send what `poll_transmit` returns until it is None.
    Call it again at `poll_timeout`, and drain `next_event`. A later `select` supersedes an open
    one, because repeating the earlier one would undo the later one.

    first_token: the first request's token. The receiver recognizes repetitions by the token, so
    each sender must start elsewhere; the shell draws it at random.

    Raises ConfigError for less than one try or a timeout that is not positive.
    """

    def __init__(
        self, *, first_token: int, tries: int = 3, timeout_ns: int = 500 * NS_PER_MS
    ) -> None:
        if tries < 1 or timeout_ns <= 0:
            raise ConfigError("telecommands need at least one try and a timeout above 0")
        self.tries = tries
        self.timeout_ns = timeout_ns
        self.sent = 0
        self.repeated = 0
        self.garbage = 0
        self.unexpected = 0
        self._next_token = first_token % _TOKEN_MODULUS
        self._request: _Request | None = None
        self._events: deque[SelectDone | SelectFailed | Housekeeping] = deque(maxlen=256)

    def select(self, name: str, now_ns: int) -> int:
        """Request the camera `name`; return the token. ConfigError: see `check_name`."""
        check_name(name)
        if self._request is not None:
            self._fail(self._request, superseded=True)
        token = self._next_token
        self._next_token = (token + 1) % _TOKEN_MODULUS
        self._request = _Request(name, token, now_ns, now_ns)
        return token

    def handle_packet(self, data: bytes, now_ns: int) -> None:
        """Telemetry arrived. Garbage is counted; this never raises."""
        try:
            message = parse_packet(data).message
        except ProtocolError:
            self.garbage += 1
            return
        if isinstance(message, Housekeeping):
            self._events.append(message)
            return
        request = self._request
        if not isinstance(message, SelectAck) or not request or message.token != request.token:
            self.unexpected += 1
            return
        self._request = None
        self._events.append(
            SelectDone(message.name, message.token, message.ok, now_ns - request.first_ns)
        )

    def poll_transmit(self, now_ns: int) -> bytes | None:
        """Return the packet to send now, or None. Gives up when the last try timed out."""
        request = self._request
        if request is None or now_ns < request.due_ns:
            return None
        if request.tries == self.tries:
            self._request = None
            self._fail(request, superseded=False)
            return None
        if request.tries:
            self.repeated += 1
        request.tries += 1
        request.due_ns = now_ns + self.timeout_ns
        data = pack_packet(SelectCamera(request.name, request.token), self.sent)
        self.sent += 1
        return data

    def poll_timeout(self) -> int | None:
        """When `poll_transmit` has something to do; None while no telecommand is open."""
        return self._request.due_ns if self._request else None

    def next_event(self) -> SelectDone | SelectFailed | Housekeeping | None:
        """The oldest event that was not fetched yet, or None."""
        return self._events.popleft() if self._events else None

    def _fail(self, request: _Request, *, superseded: bool) -> None:
        self._events.append(SelectFailed(request.name, request.token, request.tries, superseded))


class TelecommandReceiver:
    """Returns each telecommand once, and acknowledges every copy of it.

    After `handle_packet`, drain `next_event`, execute each `SelectCamera`, and report its result
    with `handle_result`. Then send what `poll_transmit` returns until it is None.

    A token is remembered for `memory_ns`; at most 64 of them. At most 16 answers wait. Beyond that
    the oldest is dropped and counted, because its telecommand will be repeated.
    """

    def __init__(self, *, memory_ns: int = 60 * NS_PER_S) -> None:
        self.memory_ns = memory_ns
        self.executed = 0
        self.duplicates = 0
        self.garbage = 0
        self.dropped_answers = 0
        self.sent = 0
        self._known: OrderedDict[tuple[int, str], tuple[int, SelectAck | None]] = OrderedDict()
        self._events: deque[SelectCamera] = deque()
        self._answers: deque[SelectAck] = deque()
        self._housekeeping: Housekeeping | None = None

    def handle_packet(self, data: bytes, now_ns: int) -> None:
        """A telecommand arrived. Garbage is counted; this never raises."""
        try:
            message = parse_packet(data).message
        except ProtocolError:
            self.garbage += 1
            return
        if not isinstance(message, SelectCamera):
            self.garbage += 1
            return
        self._forget(now_ns)
        key = (message.token, message.name)
        if key in self._known:
            self.duplicates += 1
            answer = self._known[key][1]
            if answer is not None:
                self._answer(answer)
            return
        if len(self._known) == _KNOWN_DEPTH:
            self._known.popitem(last=False)
        self._known[key] = (now_ns, None)
        self._events.append(message)

    def handle_result(self, request: SelectCamera, *, ok: bool, selected: str, now_ns: int) -> None:
        """Report that `request` was executed or refused, and which camera is selected now."""
        answer = SelectAck(selected, request.token, ok)
        key = (request.token, request.name)
        self._known[key] = (now_ns, answer)
        self._known.move_to_end(key)
        if ok:
            self.executed += 1
        self._answer(answer)

    def handle_housekeeping(self, message: Housekeeping, now_ns: int) -> None:
        """Send `message`; it replaces one that was not sent yet."""
        self._housekeeping = message

    def poll_transmit(self, now_ns: int) -> bytes | None:
        """The telemetry packet to send now, acknowledgements first, or None."""
        message: Message
        if self._answers:
            message = self._answers.popleft()
        elif self._housekeeping is not None:
            message, self._housekeeping = self._housekeeping, None
        else:
            return None
        data = pack_packet(message, self.sent)
        self.sent += 1
        return data

    def poll_timeout(self) -> int | None:
        """Always None: nothing here waits for an instant."""
        return None

    def next_event(self) -> SelectCamera | None:
        """The next telecommand to execute, or None."""
        return self._events.popleft() if self._events else None

    def _answer(self, answer: SelectAck) -> None:
        if len(self._answers) == _ANSWERS_DEPTH:
            self._answers.popleft()
            self.dropped_answers += 1
        self._answers.append(answer)

    def _forget(self, now_ns: int) -> None:
        while self._known:
            key = next(iter(self._known))
            if now_ns - self._known[key][0] <= self.memory_ns:
                return
            del self._known[key]
