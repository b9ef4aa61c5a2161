"""How a thread wakes the loop that it works for."""

import os


class Doorbell:
    """Readable from `ring` on, until it was `answered`: an eventfd(2), for a loop that sleeps on
    file descriptors."""

    def __init__(self) -> None:
        self._fd = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)

    def fileno(self) -> int:
        return self._fd

    def ring(self) -> None:
        """Wake the loop. What it is woken for must be there already."""
        os.eventfd_write(self._fd, 1)

    def answered(self) -> bool:
        """Whether it was rung since it was last asked."""
        try:
            os.eventfd_read(self._fd)
        except BlockingIOError:
            return False
        return True

    def close(self) -> None:
        """Give the file descriptor back: nobody rings any more."""
        os.close(self._fd)
