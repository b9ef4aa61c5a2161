"""Wakes any number of sleeping readers with one system call of the writer.

A notifier is a FIFO (fifo(7)) in shared memory. To notify means to write one octet, which nobody
needs to read. All listeners watch the FIFO edge-triggered through epoll(7). Each write wakes each
of them once, and the kernel remembers it for a listener that is not waiting at the moment.

No state is shared between the processes, so a killed one cannot leave anything inconsistent. A
listener sees everything that was written before the notification, because both sides took the
kernel's lock of the wait queue. If the last notifier is killed, the kernel closes its end, which
wakes the listeners as well.

epoll reports each write as an edge, even if the pipe holds octets already. Linux guarantees this
since 5.14 ("pipe: make pipe writes always wake up readers"). Versions 5.5 to 5.13 lack it, except
the later releases of 5.10 and 5.13. `kontur-av doctor` tests it.

A futex needs one system call too, but a wait for it cannot include sockets, and Python has no
atomic operation to count the waiters.
"""

import mmap
import os
import select
import stat
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ConfigError

#: Limit of select(2).
_FD_SETSIZE = 1024


class _Fifo:
    """An open end of the FIFO; it is closed with its last reference."""

    _fd = -1

    def __init__(self, path: Path, mode: int) -> None:
        self._fd = _open_own_fifo(path, mode)

    def fileno(self) -> int:
        return self._fd

    def close(self) -> None:
        """Close the end; a second call does nothing."""
        fd, self._fd = self._fd, -1
        if fd >= 0:
            os.close(fd)

    def __del__(self) -> None:
        self.close()


class Notifier(_Fifo):
    """The writer's end. path: the FIFO, created if it does not exist."""

    def __init__(self, path: Path) -> None:
        # Read and write: this opens without a listener, and `_make_room` must read.
        super().__init__(path, os.O_RDWR)

    def notify(self) -> None:
        """Wake all listeners. Never blocks."""
        while True:
            try:
                os.write(self._fd, b"\0")
            except BlockingIOError:
                self._make_room()
            else:
                return

    def _make_room(self) -> None:
        # Read the oldest of sixteen pages, never all. A listener that was woken but has not run yet
        # would find the pipe empty and sleep on if this process were killed now.
        with suppress(BlockingIOError):
            os.read(self._fd, mmap.PAGESIZE)


class NotificationListener(_Fifo):
    """A reader's end, for a `WaitSet`. path: the FIFO, created if it does not exist."""

    def __init__(self, path: Path) -> None:
        # Read only: with a write end here, the death of the last notifier would go unnoticed.
        super().__init__(path, os.O_RDONLY)


class WaitSet:
    """Waits for one of several notifiers, or until a file descriptor is readable.

    For use in one thread. Several wait sets may share a listener; each one is woken.
    """

    def __init__(
        self, listeners: Sequence[NotificationListener], readable: Sequence[int] = ()
    ) -> None:
        self._epoll = select.epoll()
        self._selectable = self._epoll.fileno() < _FD_SETSIZE
        self._most = max(1, len(listeners) + len(readable))
        for listener in listeners:
            self._epoll.register(listener, select.EPOLLIN | select.EPOLLET)
        for fd in readable:
            self._epoll.register(fd, select.EPOLLIN)

    def fileno(self) -> int:
        """Return a descriptor that is readable while a notification waits, for an event loop.

        `wait(0)` takes the notifications.
        """
        return self._epoll.fileno()

    def wait(self, timeout_ns: int, awake: Callable[[], bool] = lambda: True) -> bool:
        """Wait for a notification for which `awake` returns True; return False on timeout.

        A notification since the last call counts. `awake` is called only after a notification.
        """
        deadline_ns = time.monotonic_ns() + timeout_ns
        while self._notified(timeout_ns):
            if awake():
                return True
            timeout_ns = deadline_ns - time.monotonic_ns()
        return False

    def _notified(self, timeout_ns: int) -> bool:
        whole_ms, rest_ns = divmod(max(0, timeout_ns), NS_PER_MS)
        if rest_ns and not self._selectable:
            whole_ms, rest_ns = whole_ms + 1, 0
        if whole_ms or not rest_ns:
            # Half a millisecond less, because epoll rounds fractions up.
            if self._epoll.poll(max(0.0, (whole_ms - 0.5) / 1000), self._most):
                return True
            if not rest_ns:
                return False
        # epoll_wait(2) counts in milliseconds; select(2) does not.
        ready, _, _ = select.select((self._epoll,), (), (), rest_ns / NS_PER_S)
        return bool(ready and self._epoll.poll(0, self._most))


def _open_own_fifo(path: Path, mode: int) -> int:
    """Open the FIFO; ConfigError if another user may have created it, as /dev/shm is shared."""
    with suppress(FileExistsError):
        os.mkfifo(path, 0o600)
    try:
        fd = os.open(path, mode | os.O_NONBLOCK | os.O_NOFOLLOW | os.O_CLOEXEC)
    except OSError as error:
        if _is_own_fifo(path.lstat()):
            raise
        raise ConfigError(f"{path} is no FIFO of yours: remove it") from error
    if not _is_own_fifo(os.fstat(fd)):
        os.close(fd)
        raise ConfigError(f"{path} is no FIFO of yours: remove it")
    return fd


def _is_own_fifo(found: os.stat_result) -> bool:
    return stat.S_ISFIFO(found.st_mode) and found.st_uid == os.geteuid()
