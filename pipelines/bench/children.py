"""Processes that a bench starts, and their end with it."""

import signal
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from time import monotonic
from types import FrameType

#: How long what was asked to end may take.
_END_S = 10.0


@contextmanager
def ended_alike() -> Iterator[None]:
    """SIGTERM interrupts as Ctrl-C does, and so does a terminal that is closed."""

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGHUP)}
    for number, handler in before.items():
        # `nohup` means it.
        if handler is not signal.SIG_IGN:
            signal.signal(number, interrupt)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def end_all(processes: Sequence[subprocess.Popen[bytes]]) -> None:
    """End those that still run, whatever they do: at once if this is interrupted, too."""
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
