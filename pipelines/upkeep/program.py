"""A program that is run and watched: the file `run` of a folder, and the status that it tells."""

import ctypes
import os
import signal
import subprocess
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

from telepresence.upkeep.manifest import RUN
from telepresence.upkeep.version_stack import VARIABLE, VersionStatus, pack_status

#: How long a program may take to end after SIGTERM.
_END_S = 10.0
_LARGEST_STATUS = 4096
_PR_SET_PDEATHSIG = 1
_LIBC = ctypes.CDLL(None)


def _end_with_the_keeper() -> None:
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


class Program:
    """Starts and ends one program at a time. status: the file in which it tells how it is."""

    def __init__(self, status: Path, arguments: Sequence[str]) -> None:
        self._status, self._arguments = status.absolute(), list(arguments)
        self._process: subprocess.Popen[bytes] | None = None
        self._seen: tuple[int, int] | None = None

    def start(self, folder: Path) -> bool:
        self.stop()
        self._status.unlink(missing_ok=True)
        self._seen = None
        try:
            self._process = subprocess.Popen(
                [str((folder / RUN).absolute()), *self._arguments],
                cwd=folder,
                env={**os.environ, VARIABLE: str(self._status)},
                stdin=subprocess.DEVNULL,
                # Its children end with it, and Ctrl-C does not reach it twice.
                start_new_session=True,
                # One that outlived a killed keeper would hold the ports of the next.
                preexec_fn=_end_with_the_keeper,
            )
        except OSError:
            return False
        return True

    def stop(self) -> None:
        """End the program and its children, if it runs."""
        process, self._process = self._process, None
        if process is None:
            return
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGTERM)
        with suppress(subprocess.TimeoutExpired):
            process.wait(_END_S)
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()

    def exit_code(self) -> int | None:
        """The exit code of a program that has ended by itself, once; None else."""
        code = None if self._process is None else self._process.poll()
        if code is not None:
            # Children that it has left behind.
            self.stop()
        return code

    def news(self) -> bytes | None:
        """What the program has told since the last call; None if it has told nothing."""
        try:
            with self._status.open("rb") as file:
                state = os.fstat(file.fileno())
                told = state.st_ino, state.st_mtime_ns
                octets = file.read(_LARGEST_STATUS)
        except OSError:
            return None
        if told == self._seen:
            return None
        self._seen = told
        return octets


def status_teller() -> Callable[[VersionStatus], None] | None:
    """Return what tells the status to whom runs this process; None if nobody asks for it."""
    name = os.environ.get(VARIABLE)
    if not name:
        return None
    path = Path(name)

    def tell(status: VersionStatus) -> None:
        # A full disk must not end the link: silence tells enough.
        with suppress(OSError):
            unfinished = path.with_name(f"{path.name}.{os.getpid()}")
            unfinished.write_bytes(pack_status(status))
            unfinished.replace(path)

    return tell
