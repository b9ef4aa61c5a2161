"""The process of a command: signals that end it, the processes that it has started, its output."""

import ctypes
import fcntl
import os
import re
import select
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from time import monotonic
from types import FrameType
from typing import Any

#: Ctrl-C, the end by another program, and a closed terminal.
ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
#: How long processes may take to end after SIGTERM, together.
_END_S = 10.0

_PR_SET_PDEATHSIG = 1
_LIBC = ctypes.CDLL(None)


def end_with_parent() -> None:
    """In a new process: end by SIGTERM when its parent ends, also when that is killed."""
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


@contextmanager
def handled(
    handler: Callable[[int, FrameType | None], object], numbers: Sequence[signal.Signals] = ENDING
) -> Iterator[None]:
    """Within it, these signals call `handler`. nohup(1) ignores SIGHUP: that stays so."""
    before = {number: signal.getsignal(number) for number in numbers}
    if before.get(signal.SIGHUP) is signal.SIG_IGN:
        del before[signal.SIGHUP]
    for number in before:
        signal.signal(number, handler)
    try:
        yield
    finally:
        for number, restored in before.items():
            signal.signal(number, restored)


@contextmanager
def ended_alike() -> Iterator[None]:
    """Within it, SIGTERM and SIGHUP (a closed terminal) raise KeyboardInterrupt, as Ctrl-C does."""

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    with handled(interrupt, (signal.SIGTERM, signal.SIGHUP)):
        yield


def end_all(processes: Sequence[subprocess.Popen[bytes]]) -> None:
    """Terminate the processes that still run; kill those that take too long.

    An interrupt in the meantime kills all of them at once.
    """
    try:
        for process in processes:
            process.terminate()
        until_s = monotonic() + _END_S
        for process in processes:
            process.wait(max(0.0, until_s - monotonic()))
    except subprocess.TimeoutExpired:
        pass
    finally:
        for process in processes:
            process.kill()
        for process in processes:
            process.wait()


@contextmanager
def stopped_by_signals() -> Iterator[Callable[[], bool]]:
    """Within this context, Ctrl-C, SIGTERM and SIGHUP only make the yielded function True."""
    caught: list[int] = []
    with handled(lambda got, _: caught.append(got)):
        yield lambda: bool(caught)


#: Also what turns the direction of a line, or ends it, in Unicode.
_CONTROL = re.compile("[\0-\x08\x0b-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069]")


def plain(text: str) -> str:
    """Return the text with its control characters escaped, but for tabs and ends of lines."""
    return _CONTROL.sub(lambda found: found[0].encode("unicode_escape").decode(), text)


class OwnOutput:
    """A standard stream for our own control sequences; any other text is escaped on its way."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> Any:
        return type(self._stream).write(self._stream, text)

    def write_words(self, text: str) -> Any:
        return self.write(plain(text))


def prepare_output() -> None:
    """Make standard output and standard error fit for any text, even if the caller closed them.

    Words of drivers, peers and files cannot control the terminal.
    """
    # Else the next file that is opened would get the words.
    for fd in range(3):
        try:
            unfit = fd > 0 and fcntl.fcntl(fd, fcntl.F_GETFL) & os.O_ACCMODE == os.O_RDONLY
        except OSError:
            unfit = True
        if unfit:
            nowhere = os.open(os.devnull, os.O_RDWR)
            if nowhere != fd:
                os.dup2(nowhere, fd)
                os.close(nowhere)
    for name, fd in (("stdout", 1), ("stderr", 2)):
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(fd, "w", closefd=False))
        stream: Any = getattr(sys, name)
        with suppress(AttributeError):
            stream.reconfigure(errors="backslashreplace")
            stream.write = OwnOutput(stream).write_words


def keep_words_apart(args: object) -> None:
    """Print words on standard error if an option names standard output for data."""
    out = os.fstat(1)
    for value in vars(args).values():
        if isinstance(value, str | Path):
            # Not every text is a path, and some are too long.
            with suppress(OSError, ValueError):
                if os.path.samestat(Path(value).stat(), out):
                    sys.stdout = sys.stderr
                    return


#: In the memory that `ps` shows of a command: a token, and of an address all but its beginning.
_SECRETS = re.compile(
    rb"\0--tok(?:en?)?[\0=]([^\0]+)|(?:[a-z]:[/\\]{2}|\b(?:rtsp[a-z]*|rtmps?|https?|srt|rtp):)[/\\]*"
    rb"(?:([^\0]*[?#;=&%][^\0]*)|[\w.-]*:?([^\0]*)@)",
    re.IGNORECASE,
)


def hide_secrets() -> None:
    """Overwrite secrets of this process's command line, which every user of the machine can see."""
    # An emulated /proc may have fewer fields.
    with suppress(OSError, IndexError):
        fields = Path("/proc/self/stat").read_text().rpartition(")")[2].split()
        begin, end = int(fields[45]), int(fields[46])  # arg_start and arg_end of proc(5)
        for found in _SECRETS.finditer(ctypes.string_at(begin, end - begin)):
            first, last = found.span(found.lastindex or 0)
            ctypes.memset(begin + first, ord("x"), last - first)


def print_data(text: str) -> None:
    """Write `text` to standard output in UTF-8, whatever the locale."""
    sys.stdout.flush()
    sys.stdout.buffer.write(text.encode())
    sys.stdout.buffer.flush()


def reader_gone() -> bool:
    """Return whether standard output is a pipe whose reader, such as head(1), has ended."""
    poller = select.poll()
    poller.register(1, 0)
    return any(events & select.POLLERR for _, events in poller.poll(0))


def discard_output() -> None:
    """Drop the rest of the output, because writing it at the exit would fail again."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.close(nowhere)


@contextmanager
def output_that_may_fail() -> Iterator[None]:
    """Within this context, a closed terminal or pipe loses only the output."""
    try:
        yield
        sys.stdout.flush()
    except OSError:
        discard_output()


def say(text: str) -> None:
    """Print lines for people; without a reader they are lost."""
    with output_that_may_fail():
        print(text, flush=True)
