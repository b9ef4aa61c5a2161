"""The operator's console in space: terminals ask it for a camera, and it sends telecommands."""

from collections import deque

from kontur_av.clock import NS_PER_MS, NS_PER_S
from pipelines.mission.figures import ConsoleFigures
from pipelines.session.probe import Probe
from pipelines.session.requests import Answer, Request, pack_line, parse_request
from pipelines.session.setup.table import Setup
from pipelines.session.terminal_lines import MAX_LINE_OCTETS, MOST_TERMINALS, Reply
from telepresence.haptics.mediated.wall import is_wall
from telepresence.tmtc import Housekeeping, SelectDone, SelectFailed, TelecommandSender

#: The time for a telecommand and its answer, without the radio's delay.
_ANSWER_NS = 500 * NS_PER_MS


class Console:
    """Turns the requests of terminals into telecommands, and their results into answers. A core.

    A terminal is a connection, known by a number that is never used again. Read from those in
    `asking` only. After each input send the packets of `poll_transmit` until None, then drain
    `next_event`.
    """

    def __init__(self, setup: Setup, probe: Probe, *, first_token: int) -> None:
        self._cameras = setup.cameras
        self._probe = probe
        self._housekeeping = 0
        self._wall: bytes | None = None
        self._sender = telecommand_sender(setup, first_token=first_token)
        #: By terminal: what it has sent so far of its request.
        self._lines: dict[int, bytes] = {}
        #: By terminal: the token of the telecommand for which it waits.
        self._waiting: dict[int, int] = {}
        self._replies: deque[Reply] = deque()

    @property
    def asking(self) -> list[int]:
        """The terminals whose requests are not complete yet."""
        return list(self._lines)

    def handle_terminal(self, terminal: int) -> None:
        """A terminal has connected."""
        if len(self._lines) + len(self._waiting) >= MOST_TERMINALS:
            self._replies.append(Reply(terminal, b"", last=True))
        else:
            self._lines[terminal] = b""

    def handle_octets(self, terminal: int, data: bytes, now_ns: int) -> None:
        """A terminal in `asking` has sent octets; b"" if it has closed its side."""
        line = self._lines[terminal] = self._lines[terminal] + data
        if b"\n" not in line and data and len(line) < MAX_LINE_OCTETS:
            return
        del self._lines[terminal]
        request = parse_request(line)
        if request is None:
            self._replies.append(Reply(terminal, b"", last=True))
        else:
            self._handle_request(terminal, request, now_ns)

    def _handle_request(self, terminal: int, request: Request, now_ns: int) -> None:
        camera = request.select
        if not isinstance(camera, str) or camera not in self._cameras:
            known = ", ".join(self._cameras)
            error = f"unknown camera {camera}: choose one of {known}"
            self._answer(terminal, Answer(ok=False, error=error, mistake=True))
            return
        self._waiting[terminal] = self._sender.select(camera, now_ns)
        wait_s = self._sender.tries * self._sender.timeout_ns / NS_PER_S
        self._replies.append(Reply(terminal, pack_line(Answer(wait_s=wait_s)), last=False))

    def handle_packet(self, datagram: bytes, now_ns: int) -> None:
        """A datagram of the telemetry port."""
        if is_wall(datagram):
            self._wall = datagram
        else:
            self._sender.handle_packet(datagram, now_ns)

    def poll_wall(self) -> bytes | None:
        """Return the newest message with a wall, once, for the joystick; or None."""
        wall, self._wall = self._wall, None
        return wall

    def poll_transmit(self, now_ns: int) -> bytes | None:
        """The next telecommand. Call until None."""
        return self._sender.poll_transmit(now_ns)

    def poll_timeout(self) -> int | None:
        """When `poll_transmit` has something next."""
        return self._sender.poll_timeout()

    def next_event(self) -> Reply | None:
        """Return the next octets for a terminal, or None."""
        while (event := self._sender.next_event()) is not None:
            if isinstance(event, Housekeeping):
                self._housekeeping += 1
            else:
                self._handle_result(event)
        return self._replies.popleft() if self._replies else None

    def _handle_result(self, event: SelectDone | SelectFailed) -> None:
        if isinstance(event, SelectDone):
            round_trip_ms = event.round_trip_ns / NS_PER_MS
            answer = Answer(ok=event.ok, camera=event.name, round_trip_ms=round_trip_ms)
        else:
            why = "a later request came" if event.superseded else "no acknowledgement came"
            answer = Answer(ok=False, error=f"select {event.name}: {why}")
        for terminal in [key for key, token in self._waiting.items() if token == event.token]:
            del self._waiting[terminal]
            self._answer(terminal, answer)

    def _answer(self, terminal: int, answer: Answer) -> None:
        self._replies.append(Reply(terminal, pack_line(answer), last=True))

    def tell(self) -> None:
        """Put the counters into the probe."""
        sender = self._sender
        self._probe.tell(
            ConsoleFigures(
                telecommands=sender.sent,
                telecommands_repeated=sender.repeated,
                garbage=sender.garbage,
                housekeeping=self._housekeeping,
            )
        )


def telecommand_sender(setup: Setup, *, first_token: int) -> TelecommandSender:
    """Return a sender that repeats a telecommand only after its answer could have come."""
    delay_ns = setup.radio_profile.longest_delay_ns
    return TelecommandSender(first_token=first_token, timeout_ns=_ANSWER_NS + 2 * delay_ns)
