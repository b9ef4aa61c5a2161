"""Ending the processes that a bench has started."""

import signal
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from time import monotonic
from types import FrameType

#: How long processes may take to end after SIGTERM, together.
_END_S = 10.0


@contextmanager
def ended_alike() -> Iterator[None]:
    """Within it, SIGTERM and SIGHUP (a closed terminal) raise KeyboardInterrupt, as Ctrl-C does."""

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGHUP)}
    for number, handler in before.items():
        # `nohup` ignores SIGHUP: leave it so.
        if handler is not signal.SIG_IGN:
            signal.signal(number, interrupt)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


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
