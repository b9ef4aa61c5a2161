"""A bell wakes any number of sleepers, whoever rings it makes one system call.

It is a FIFO (fifo(7)) in shared memory. Ringing writes one octet that nobody will read: all who
listen have it watched edge-triggered by epoll(7), so that each ring wakes each of them once, and
the kernel remembers for each whether it was rung since they last looked. That leaves nothing to
go wrong between processes: there is no word to keep in order, no count of sleepers and no lock,
hence nothing that a process can take along when it is killed. A ring before the sleep ends that
sleep at once. What was done before a ring is seen by whom it wakes: both took the kernel's lock
of the listener's queue, on any processor.

A ringer that is killed before it could ring rings nevertheless, if no other ringer lives: the
kernel closes its end, and listeners wake for that, too.

That each write is an edge, however much lies in the pipe, is what epoll has always done, and what
Linux has promised since a release without it broke programs (Linux 5.14, "pipe: make pipe writes
always wake up readers"). 5.5 to 5.13 lack it, but for the later releases of 5.10 and 5.13;
`kontur-av doctor` tries it.

A futex would do with one system call as well, but no way leads from there to a sleep that a
socket ends, too, and Python has no atomic operation to count sleepers with. To have the first
sleeper wake the others would cost the ringer less; but when that one is killed, stopped or busy,
all others sleep on.
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

#: What select(2) can name.
_FD_SETSIZE = 1024


class _Fifo:
    """An open end; it closes itself when nobody holds it any more."""

    _fd = -1

    def __init__(self, path: Path, mode: int) -> None:
        self._fd = _open_own_fifo(path, mode)

    def fileno(self) -> int:
        return self._fd

    def close(self) -> None:
        """Give the end back; a second time does nothing."""
        fd, self._fd = self._fd, -1
        if fd >= 0:
            os.close(fd)

    def __del__(self) -> None:
        self.close()


class Bell(_Fifo):
    """What a ringer holds. path: the FIFO, made if it is not there."""

    def __init__(self, path: Path) -> None:
        # For reading, too: so it opens without a listener, and can make room.
        super().__init__(path, os.O_RDWR)

    def ring(self) -> None:
        """Wake all who listen. Never blocks."""
        while True:
            try:
                os.write(self._fd, b"\0")
            except BlockingIOError:
                self._make_room()
            else:
                return

    def _make_room(self) -> None:
        # The oldest of sixteen pages. Never all: a listener who was woken, but has not run yet,
        # would find the pipe empty and sleep on, if this process were killed now.
        with suppress(BlockingIOError):
            os.read(self._fd, mmap.PAGESIZE)


class Ear(_Fifo):
    """What a listener holds, for a `Sleeper`. path: the FIFO, made if it is not there."""

    def __init__(self, path: Path) -> None:
        # For reading only: else the death of the last ringer would change nothing here.
        super().__init__(path, os.O_RDONLY)


class Sleeper:
    """Sleeps until one of several bells rings, or one of several file descriptors is readable.

    For one thread. Several sleepers may listen with the same ear: a ring wakes each of them.
    """

    def __init__(self, ears: Sequence[Ear], readable: Sequence[int] = ()) -> None:
        self._epoll = select.epoll()
        self._selectable = self._epoll.fileno() < _FD_SETSIZE
        self._most = max(1, len(ears) + len(readable))
        for ear in ears:
            self._epoll.register(ear, select.EPOLLIN | select.EPOLLET)
        for fd in readable:
            self._epoll.register(fd, select.EPOLLIN)

    def sleep(self, timeout_ns: int, awake: Callable[[], bool] = lambda: True) -> bool:
        """Sleep until something rang and `awake` agrees (True), or the time is over (False).

        A ring since the last sleep counts. `awake` is asked after a ring only.
        """
        deadline_ns = time.monotonic_ns() + timeout_ns
        while self._rung(timeout_ns):
            if awake():
                return True
            timeout_ns = deadline_ns - time.monotonic_ns()
        return False

    def _rung(self, timeout_ns: int) -> bool:
        whole_ms, rest_ns = divmod(max(0, timeout_ns), NS_PER_MS)
        if rest_ns and not self._selectable:
            whole_ms, rest_ns = whole_ms + 1, 0
        if whole_ms or not rest_ns:
            # Half a millisecond less, because what is no whole number of them is rounded up.
            if self._epoll.poll(max(0.0, (whole_ms - 0.5) / 1000), self._most):
                return True
            if not rest_ns:
                return False
        # epoll_wait(2) counts in milliseconds; select(2) does not.
        ready, _, _ = select.select((self._epoll,), (), (), rest_ns / NS_PER_S)
        return bool(ready and self._epoll.poll(0, self._most))


def _open_own_fifo(path: Path, mode: int) -> int:
    """ConfigError when another user could have put there what is found: it is everybody's."""
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
