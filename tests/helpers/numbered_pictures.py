"""Numbered pictures as another program writes them into a FIFO, and their numbers read back."""

import contextlib
import os
import threading

import cv2
import numpy as np
from browser import luma

from kontur_av.media import planes
from pipelines.bench.course import marks

WIDTH, HEIGHT, FPS = 640, 480, 15
_HEADER = b"YUV4MPEG2 W%d H%d F%d:1 Ip A1:1 C420jpeg\n" % (WIDTH, HEIGHT, FPS)
_FRAME = b"FRAME\n"


def numbered_picture(number, *, bright=False):
    """Return an I420 picture with a number, on a slope on which a wrong beginning is seen."""
    picture = np.full((HEIGHT * 3 // 2, WIDTH), 128, np.uint8)
    shades = planes(picture)[0]
    shades[:] = np.add.outer(np.arange(HEIGHT) * 60 // HEIGHT, np.arange(WIDTH) * 60 // WIDTH) + 30
    shades[HEIGHT // 2 :: 40] = 50
    if bright:
        shades += 80
    marks.draw_number(picture, number)
    return picture


def number_of(pixels):
    """Return the number of a picture of any size, shape (height, width, 3), RGB; None in doubt.

    Numbers begin with 1, because any dark picture reads as 0.
    """
    height, width, _ = pixels.shape
    rows = 2 * -(-marks.MARK_ROWS * height // HEIGHT // 2)
    strip = luma(pixels[:rows])
    strip = cv2.resize(strip, (WIDTH, rows * WIDTH // width), interpolation=cv2.INTER_LINEAR)
    return marks.read_number(marks.levels(strip)) or None


def number_on(page, selector="#picture"):
    """Return the number of the picture that a page shows; None in doubt."""
    return number_of(page.pixels(selector))


def write_pictures(path, count, first=1):
    """Write a YUV4MPEG2 file of `count` pictures with the numbers from `first` on."""
    with path.open("wb") as file:
        file.write(_HEADER)
        for number in range(first, first + count):
            file.write(_FRAME + numbered_picture(number).tobytes())


class NumberedPictures:
    """Writes numbered pictures into a FIFO until its exit.

    newest: the number of the picture that was written last; `before` in the beginning.
    bright: whether pictures are bright. A change is a cut.
    """

    def __init__(self, fifo, before=0):
        os.mkfifo(fifo)
        self.path = fifo
        self.newest = before
        self.bright = False
        self._ended, self._flows = threading.Event(), threading.Event()
        self._flows.set()
        # For reading, too, so that no end of a session breaks the pipe.
        self._fd = os.open(fifo, os.O_RDWR)
        self._thread = threading.Thread(target=self._write)
        self._thread.start()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._ended.set()
        self._flows.set()
        os.set_blocking(self._fd, False)
        while self._thread.is_alive():
            # The thread may wait for room in the FIFO.
            with contextlib.suppress(BlockingIOError):
                os.read(self._fd, 1 << 16)
        self._thread.join()
        os.close(self._fd)

    @contextlib.contextmanager
    def paused(self):
        """Write no picture until the exit."""
        self._flows.clear()
        try:
            yield
        finally:
            self._flows.set()

    def _write(self):
        with contextlib.suppress(BlockingIOError):
            self._write_all(_HEADER)
            while not self._ended.wait(1 / FPS):
                self._flows.wait()
                number = self.newest % (marks.NUMBERS - 1) + 1
                self._write_all(_FRAME + numbered_picture(number, bright=self.bright).tobytes())
                self.newest = number

    def _write_all(self, octets):
        view = memoryview(octets)
        while view:
            view = view[os.write(self._fd, view) :]
