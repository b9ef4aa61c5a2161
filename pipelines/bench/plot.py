"""Distributions as a picture: for each of several measurements the share of values up to x.

And what other pictures are drawn with: colours, text and the distance of the marks of an axis.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from kontur_av.errors import ConfigError

_WIDTH, _HEIGHT = 900, 460
_LEFT, _RIGHT, _TOP, _BOTTOM = 70, 40, 60, 60
_FONT = cv2.FONT_HERSHEY_SIMPLEX
GREY, BLACK = (210, 210, 210), (40, 40, 40)
#: Colours that the colour-blind can tell apart (Okabe and Ito), as (B, G, R).
COLOURS = (
    (178, 114, 0),
    (0, 94, 213),
    (115, 158, 0),
    (167, 121, 204),
    (0, 159, 230),
    (233, 180, 86),
    (66, 228, 240),
    (0, 0, 0),
)


def check_plot(path: Path | None) -> None:
    """ConfigError if no picture can be written there, before anything is measured."""
    if path is None:
        return
    if path.suffix.lower() != ".png":
        raise ConfigError(f"--plot {path}: give the name of a PNG file, like latency.png")
    if not path.resolve().parent.is_dir():
        raise ConfigError(f"--plot {path}: there is no directory {path.parent}")


def plot_distributions(
    path: Path, panels: Mapping[str, Mapping[str, Sequence[float]]], *, unit: str
) -> None:
    """Write a PNG of one panel below the other: title -> {label: values in `unit`}."""
    images = [_panel(title, curves, unit) for title, curves in panels.items()]
    if not cv2.imwrite(str(path), np.concatenate(images)):
        raise ConfigError(f"--plot {path}: cannot be written")


def _panel(title: str, curves: Mapping[str, Sequence[float]], unit: str) -> NDArray[np.uint8]:
    image = np.full((_HEIGHT, _WIDTH, 3), 255, np.uint8)
    shown = {label: np.sort(np.asarray(values)) for label, values in curves.items() if len(values)}
    write_text(image, title, (_LEFT, 30), 0.6, BLACK)
    if not shown:
        write_text(image, "nothing was measured", (_LEFT, _HEIGHT // 2), 0.6, BLACK)
        return image
    # So that one value far out does not press all others together.
    largest = max(float(np.percentile(values, 99.5)) for values in shown.values())
    step = tick_step(largest)
    right = step * (int(largest / step) + 1)

    def at(value: float, share: float) -> tuple[int, int]:
        x = _LEFT + (_WIDTH - _LEFT - _RIGHT) * min(value / right, 1.0)
        y = _HEIGHT - _BOTTOM - (_HEIGHT - _TOP - _BOTTOM) * share
        return round(x), round(y)

    for percent in (0, 25, 50, 75, 100):
        cv2.line(image, at(0, percent / 100), at(right, percent / 100), GREY)
        write_text(image, f"{percent} %", (12, at(0, percent / 100)[1] + 5), 0.45, BLACK)
    for number in range(round(right / step) + 1):
        value = number * step
        cv2.line(image, at(value, 0), at(value, 1), GREY)
        write_text(image, f"{value:g}", (at(value, 0)[0] - 10, _HEIGHT - _BOTTOM + 20), 0.45, BLACK)
    write_text(image, unit, (_WIDTH - _RIGHT - 20, _HEIGHT - 15), 0.45, BLACK)
    for number, (label, values) in enumerate(shown.items()):
        colour = COLOURS[number % len(COLOURS)]
        shares = np.arange(1, len(values) + 1) / len(values)
        points = [at(0, 0), at(float(values[0]), 0)]
        points += [at(*pair) for pair in zip(values.tolist(), shares.tolist(), strict=True)]
        points.append(at(right, 1))
        line = np.array(points, np.int32)
        cv2.polylines(image, [line], False, colour, 2, cv2.LINE_AA)
        y = _HEIGHT - _BOTTOM - 14 - 18 * (len(shown) - 1 - number)
        cv2.line(image, (_WIDTH - 300, y - 4), (_WIDTH - 275, y - 4), colour, 3)
        write_text(image, label, (_WIDTH - 268, y), 0.45, BLACK)
    return image


def tick_step(largest: float) -> float:
    """Between two marks: 1, 2 or 5 times a power of ten, so that there are at most ten."""
    power = 10.0 ** np.floor(np.log10(max(largest, 1e-9) / 10))
    return float(
        next(power * factor for factor in (1, 2, 5, 10) if largest / (power * factor) < 10)
    )


def write_text(
    image: NDArray[np.uint8], text: str, at: tuple[int, int], size: float, colour: tuple[int, ...]
) -> None:
    """Put `text` into `image` with its lower left corner `at` (x, y) px; `size` 1 is 22 px high."""
    cv2.putText(image, text, at, _FONT, size, colour, 1, cv2.LINE_AA)
