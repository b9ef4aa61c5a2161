"""The same detail of the same picture by each contender, side by side in one PNG."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from kontur_av.errors import ConfigError
from pipelines.bench.course.marks import MARK_ROWS
from pipelines.bench.video.clips import Clip
from pipelines.bench.video.quality import Luma, psnr_db

#: Where in the time that counts pictures are taken.
_PARTS = (1 / 4, 1 / 2, 3 / 4)
_WIDTH, _HEIGHT = 320, 240
_STEP = 16
_ENLARGED = 2
_TITLE_ROWS = 28


def check_crops(folder: Path | None) -> None:
    """Make the folder; ConfigError if it cannot be made."""
    if folder is None:
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"--crops {folder}: cannot be made ({error.strerror})") from None


def shot_numbers(count: int, first: int) -> tuple[int, ...]:
    """The numbers of the pictures to compare, of `count`, from `first` on."""
    return tuple(first + round(part * (count - first)) for part in _PARTS)


def detail(luma: Luma) -> tuple[int, int]:
    """Top and left of the part with the strongest edges, below the number.

    A part is 320x240, or the whole where the picture is smaller.
    """
    height, width = min(_HEIGHT, luma.shape[0] - MARK_ROWS), min(_WIDTH, luma.shape[1])
    edges = np.abs(cv2.Laplacian(luma, cv2.CV_32F))
    sums = cv2.integral(edges)
    tops = range(MARK_ROWS, luma.shape[0] - height + 1, _STEP)
    lefts = range(0, luma.shape[1] - width + 1, _STEP)

    def strength(at: tuple[int, int]) -> float:
        top, left = at
        low, right = top + height, left + width
        return float(sums[low, right] - sums[top, right] - sums[low, left] + sums[top, left])

    return max(((top, left) for top in tops for left in lefts), key=strength)


def side_by_side(original: Luma, shown: Mapping[str, tuple[int, Luma]], number: int) -> Luma:
    """The detail of the original and of each contender, enlarged, with name and PSNR above.

    shown: number and picture by contender; a number other than `number` stands in the title.
    """
    top, left = detail(original)
    place = slice(top, top + _HEIGHT), slice(left, left + _WIDTH)
    panels = [_panel(f"captured, no. {number}", original[place])]
    for who, (found, luma) in shown.items():
        late = f", no. {found}" if found != number else ""
        title = f"{who}{late}, {psnr_db(luma[place].copy(), original[place].copy()):.1f} dB"
        panels.append(_panel(title, luma[place]))
    sheet: Luma = np.hstack(panels)
    return sheet


def _panel(title: str, part: NDArray[np.uint8]) -> Luma:
    height, width = part.shape
    panel = np.zeros((height * _ENLARGED + _TITLE_ROWS, width * _ENLARGED), np.uint8)
    # Each pixel as a square: an interpolation would hide what coding did.
    panel[_TITLE_ROWS:] = part.repeat(_ENLARGED, 0).repeat(_ENLARGED, 1)
    at = (8, _TITLE_ROWS - 8)
    cv2.putText(panel, title, at, cv2.FONT_HERSHEY_SIMPLEX, 0.6, 255, 1, cv2.LINE_AA)
    return panel


def write_crops(
    folder: Path,
    clip: Clip,
    cap_kbps: float,
    shots: Mapping[str, Mapping[int, tuple[int, Luma]]],
) -> list[Path]:
    """Write a PNG for each number; returns their paths. shots: by contender and number."""
    written = []
    numbers: Sequence[int] = sorted({number for of in shots.values() for number in of})
    for number in numbers:
        shown = {who: of[number] for who, of in shots.items() if number in of}
        path = folder / f"{clip.name}-{cap_kbps:g}-{number}.png"
        if not cv2.imwrite(str(path), side_by_side(clip.luma(number), shown, number)):
            raise ConfigError(f"--crops {path}: cannot be written")
        written.append(path)
    return written
