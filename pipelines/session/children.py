"""Signals that end a command, and the end of the processes that it has started."""

import signal
import subprocess
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from time import monotonic
from types import FrameType

#: Ctrl-C, the end by another program, and a closed terminal.
ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
#: How long processes may take to end after SIGTERM, together.
_END_S = 10.0


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
