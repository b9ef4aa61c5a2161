"""Takes requests to record and to stop, and says what became of them. A core."""

from typing import NamedTuple

from kontur_av.clock import NS_PER_S
from pipelines.session.terminal_lines import (
    MAX_LINE_OCTETS,
    START,
    STATE,
    STOP,
    RecordAnswer,
    RecordingOptions,
    RecordRequest,
    Reply,
    TerminalServer,
    pack_line,
    parse_line,
)

#: A held recording goes on for this long without its terminal: that may come back.
HOLD_NS = 5 * NS_PER_S


class Start(NamedTuple):
    """Begin to record, and report with `handle_started`."""

    options: RecordingOptions
    overwrite: bool
    terminal: int


class Stop(NamedTuple):
    """End the recording, and report with `handle_stopped`. terminal: who asked; None: nobody."""

    terminal: int | None


class Ask(NamedTuple):
    """A terminal asks how it goes: answer with `handle_state`."""

    terminal: int


class RecorderRequests(TerminalServer[Start | Stop | Ask]):
    """options: of the present recording. A held recording ends when no terminal holds it any more.

    Call `handle_time` at least once a second.
    """

    def __init__(self, options: RecordingOptions | None, now_ns: int) -> None:
        super().__init__()
        self.options = options
        self._holders: set[int] = set()
        self._free_ns = now_ns

    def handle_octets(self, terminal: int, data: bytes, now_ns: int) -> None:
        if terminal not in self._lines:
            return
        self._lines[terminal] += data
        *lines, rest = self._lines[terminal].split(b"\n")
        self._lines[terminal] = rest
        for line in lines:
            self._handle_line(terminal, line)
        if not data or len(rest) > MAX_LINE_OCTETS:
            self._close(terminal, now_ns)

    def handle_started(self, start: Start, error: str = "") -> None:
        """The recording has begun, or cannot: error says why."""
        if not error:
            self.options = start.options
            if start.options.held:
                self._holders.add(start.terminal)
        answer = RecordAnswer(
            ok=not error, error=error, mistake=bool(error), file=start.options.file
        )
        self._answer(start.terminal, answer)

    def handle_stopped(self, stop: Stop, answer: RecordAnswer) -> None:
        self.options = None
        for terminal in self._holders | ({stop.terminal} if stop.terminal is not None else set()):
            self._answer(terminal, answer)
        self._holders.clear()

    def handle_state(self, ask: Ask, answer: RecordAnswer) -> None:
        self._answer(ask.terminal, answer)

    def handle_time(self, now_ns: int) -> None:
        """Stop a held recording whose terminal has gone for long."""
        if self.options is None or not self.options.held or self._holders:
            self._free_ns = now_ns
        elif now_ns - self._free_ns >= HOLD_NS:
            self._free_ns = now_ns
            self._events.append(Stop(None))

    def _handle_line(self, terminal: int, line: bytes) -> None:
        request = parse_line(line, RecordRequest)
        if request is None or request.record not in (START, STOP, STATE):
            self._refuse(terminal, "no request to a recorder")
        elif request.record == STATE:
            self._events.append(Ask(terminal))
        elif request.record == STOP:
            if self.options is None:
                self._refuse(terminal, "the session is not being recorded")
            else:
                self._events.append(Stop(terminal))
        elif request.options is None:
            self._refuse(terminal, "no request to a recorder")
        elif self.options is None:
            self._events.append(Start(request.options, request.overwrite, terminal))
        elif self.options.held and request.options == self.options:
            # Its own terminal again, after this process was restarted.
            self._holders.add(terminal)
            self._answer(terminal, RecordAnswer(ok=True, file=self.options.file))
        else:
            self._refuse(terminal, f"the session is being recorded already, to {self.options.file}")

    def _refuse(self, terminal: int, why: str) -> None:
        self._answer(terminal, RecordAnswer(ok=False, error=why, mistake=True))

    def _answer(self, terminal: int, answer: RecordAnswer) -> None:
        if terminal in self._lines:
            self._events.append(Reply(terminal, pack_line(answer), last=False))

    def _close(self, terminal: int, now_ns: int) -> None:
        del self._lines[terminal]
        self._holders.discard(terminal)
        self._free_ns = now_ns
        self._events.append(Reply(terminal, b"", last=True))
