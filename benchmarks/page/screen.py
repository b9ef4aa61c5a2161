"""A virtual screen whose pixels another process reads while a browser draws."""

import os
import subprocess
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from kontur_av.clock import NS_PER_MS, MonotonicClock
from kontur_av.errors import ConfigError
from pipelines.bench.course.marks import SQUARES, read_number
from pipelines.session.command_process import end_all

#: Side of a square of `pipelines.bench.course.marks`, in pixels of the picture.
_SIDE = 16
#: Between two looks at the screen. A number is dated at most this much too late.
_LOOK_NS = NS_PER_MS // 4
_PIXEL_OCTETS = 4
#: Words of the header of an XWD file (X11/XWDFile.h), each of 32 bits, big-endian.
_HEADER_SIZE, _WIDTH, _HEIGHT, _LINE_OCTETS, _COLOURS = 0, 4, 5, 12, 19
_HEADER_WORDS = 25
_COLOUR_OCTETS = 12

Pixels = NDArray[np.uint8]


@dataclass(frozen=True, kw_only=True)
class Spot:
    """Where a numbered picture is on the screen, in pixels. scale: of the screen to the picture."""

    left: float
    top: float
    scale: float

    def points(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return rows and columns of 9 pixels in the middle of each square: (SQUARES, 9) each."""
        across = self.left + (np.arange(SQUARES) + 0.5) * _SIDE * self.scale
        down = self.top + _SIDE / 2 * self.scale
        rows = np.repeat(np.array([-1, 0, 1]), 3) + round(down)
        columns = np.tile(np.array([-1, 0, 1]), 3)[None, :] + np.rint(across)[:, None]
        return np.broadcast_to(rows, (SQUARES, 9)).astype(np.intp), columns.astype(np.intp)


class VirtualScreen:
    """Xvfb with its pixels in a file; a context manager.

    display: the value of DISPLAY for its programs.
    """

    def __init__(self, width: int, height: int, folder: Path) -> None:
        self.width, self.height = width, height
        self.display = ""
        self._folder = folder
        self._process: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Self:
        reading, writing = os.pipe()
        command = ["Xvfb", "-displayfd", str(writing), "-nolisten", "tcp", "-noreset"]
        command += ["-screen", "0", f"{self.width}x{self.height}x24", "-fbdir", str(self._folder)]
        try:
            self._process = subprocess.Popen(
                command, pass_fds=(writing,), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
            )
        except FileNotFoundError:
            os.close(reading)
            raise ConfigError("no Xvfb here: apt-get install xvfb") from None
        finally:
            os.close(writing)
        with os.fdopen(reading) as told:
            number = told.readline().strip()
        if not number:
            raise RuntimeError("Xvfb does not start")
        self.display = f":{number}"
        return self

    def __exit__(self, *_: object) -> None:
        if self._process is not None:
            end_all([self._process])

    @property
    def file(self) -> Path:
        """The file that holds the pixels."""
        return self._folder / "Xvfb_screen0"


def pixels_of(file: Path) -> Pixels:
    """Map the pixels of a screen: (height, width, 4), uint8, read-only."""
    words = np.fromfile(file, ">u4", _HEADER_WORDS).astype(np.int64).tolist()
    offset = words[_HEADER_SIZE] + words[_COLOURS] * _COLOUR_OCTETS
    height, line = words[_HEIGHT], words[_LINE_OCTETS]
    flat = np.memmap(file, np.uint8, "r", offset, (height, line))
    return flat[:, : words[_WIDTH] * _PIXEL_OCTETS].reshape(height, words[_WIDTH], _PIXEL_OCTETS)


def number_at(pixels: Pixels, points: tuple[NDArray[np.intp], NDArray[np.intp]]) -> int | None:
    """Return the number that the screen shows at a spot's points; None where there is doubt."""
    # Any colour channel will do: the squares are grey.
    found = pixels[points[0], points[1], 1]
    return read_number(np.rint(found.mean(1, dtype=np.float32)).astype(np.uint8))


def watch(file: Path, spots: Sequence[Spot], seen: Sequence[Any], stopping: Any) -> None:
    """Write the instant in ns at which each number was first seen into seen[view][number].

    stopping: a shared flag that ends it. For a process of its own.
    """
    clock, pixels = MonotonicClock(), pixels_of(file)
    points = [spot.points() for spot in spots]
    newest: list[int | None] = [None] * len(spots)
    with suppress(KeyboardInterrupt):
        while not stopping.value:
            for view, where in enumerate(points):
                number = number_at(pixels, where)
                now_ns = clock.now_ns()
                if number is not None and number != newest[view]:
                    newest[view] = number
                    if not seen[view][number]:
                        seen[view][number] = now_ns
            clock.sleep_until_ns(clock.now_ns() + _LOOK_NS)
