"""Courses in time and maps of cells as pictures, in the manner of `pipelines.bench.plot`."""

from collections.abc import Mapping, Sequence
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from pipelines.bench.plot import BLACK, COLOURS, GREY, tick_step, write_text

_LEFT, _RIGHT, _TOP, _BOTTOM = 70, 20, 60, 40
_SHADE = (235, 235, 235)
_LEGEND = 12

Image = NDArray[np.uint8]


def series_panel(
    title: str,
    curves: Mapping[str, NDArray[np.float64]],
    *,
    period_s: float,
    unit: str,
    shaded_s: Sequence[tuple[float, float]] = (),
    limits: tuple[float, float] | None = None,
    size: tuple[int, int] = (760, 260),
) -> Image:
    """A panel of {label: values in `unit`, one each `period_s`}; (height, width, 3) uint8.

    shaded_s: stretches of time drawn darker. limits: of the axis in `unit`; None: what the
    values reach. Of many values to a column of pixels the least and the largest are drawn.
    """
    width, height = size
    image = np.full((height, width, 3), 255, np.uint8)
    write_text(image, title, (_LEFT, 22), 0.5, BLACK)
    seconds = max(len(values) for values in curves.values()) * period_s
    low, high = limits or _reach(curves)
    inner_w, inner_h = width - _LEFT - _RIGHT, height - _TOP - _BOTTOM

    def x_at(second: float) -> int:
        return round(_LEFT + inner_w * second / seconds)

    def y_at(value: float) -> int:
        share = (value - low) / (high - low)
        return round(height - _BOTTOM - inner_h * min(max(share, 0.0), 1.0))

    for begin, end in shaded_s:
        corner = (x_at(min(end, seconds)), height - _BOTTOM)
        cv2.rectangle(image, (x_at(begin), _TOP), corner, _SHADE, -1)
    for value in _ticks(low, high):
        cv2.line(image, (_LEFT, y_at(value)), (width - _RIGHT, y_at(value)), GREY)
        write_text(image, f"{value:g}", (10, y_at(value) + 4), 0.4, BLACK)
    for second in _ticks(0.0, seconds):
        cv2.line(image, (x_at(second), _TOP), (x_at(second), height - _BOTTOM), GREY)
        write_text(image, f"{second:g}", (x_at(second) - 8, height - _BOTTOM + 16), 0.4, BLACK)
    write_text(image, "s", (width - _RIGHT - 8, height - 8), 0.4, BLACK)
    write_text(image, unit, (10, _TOP - 12), 0.4, BLACK)
    at = _LEFT
    for number, (label, values) in enumerate(curves.items()):
        colour = COLOURS[number % len(COLOURS)]
        line = [(_LEFT + column, y_at(value)) for column, value in _thinned(values, inner_w)]
        cv2.polylines(image, [np.array(line, np.int32)], False, colour, 1, cv2.LINE_AA)
        cv2.line(image, (at, _TOP - 16), (at + _LEGEND, _TOP - 16), colour, 3)
        write_text(image, label, (at + _LEGEND + 5, _TOP - 12), 0.4, BLACK)
        at += _LEGEND + 25 + 7 * len(label)
    return image


def map_panel(
    title: str,
    *,
    columns: Sequence[str],
    rows: Sequence[str],
    good: NDArray[np.bool_],
    texts: Sequence[Sequence[str]],
    size: tuple[int, int] = (760, 260),
) -> Image:
    """A map of cells: blue where `good` (rows, columns), orange where not, with a text in each."""
    width, height = size
    image = np.full((height, width, 3), 255, np.uint8)
    write_text(image, title, (_LEFT, 22), 0.5, BLACK)
    left = 110
    cell_w, cell_h = (width - left - _RIGHT) / len(columns), (height - _TOP - _BOTTOM) / len(rows)
    for row, name in enumerate(rows):
        top = round(_TOP + row * cell_h)
        write_text(image, name, (10, top + round(cell_h / 2) + 5), 0.4, BLACK)
        for column in range(len(columns)):
            corner = (round(left + column * cell_w) + 1, top + 1)
            other = (round(left + (column + 1) * cell_w) - 1, round(top + cell_h) - 1)
            # Light, so that the text stays readable; hue and text both tell which it is.
            colour = (245, 205, 160) if good[row, column] else (110, 170, 250)
            cv2.rectangle(image, corner, other, colour, -1)
            at = (corner[0] + 6, top + round(cell_h / 2) + 5)
            write_text(image, texts[row][column], at, 0.4, BLACK)
    for column, name in enumerate(columns):
        write_text(
            image, name, (round(left + column * cell_w) + 6, height - _BOTTOM + 18), 0.4, BLACK
        )
    return image


def _reach(curves: Mapping[str, NDArray[np.float64]]) -> tuple[float, float]:
    low = min(float(values.min()) for values in curves.values())
    high = max(float(values.max()) for values in curves.values())
    margin = 0.05 * (high - low) or 1.0
    return low - margin, high + margin


def _ticks(low: float, high: float) -> list[float]:
    step = tick_step(high - low)
    first = int(np.ceil(low / step))
    return [number * step for number in range(first, int(np.floor(high / step)) + 1)]


def _thinned(values: NDArray[np.float64], columns: int) -> list[tuple[int, float]]:
    """(column, value) points: at most two a column, so that no peak is lost."""
    if len(values) <= columns:
        step = columns / max(len(values), 1)
        return [(round(number * step), float(value)) for number, value in enumerate(values)]
    points: list[tuple[int, float]] = []
    edges = np.linspace(0, len(values), columns + 1).astype(int)
    for column, (begin, end) in enumerate(pairwise(edges.tolist())):
        part = values[begin:end]
        least, most = int(part.argmin()), int(part.argmax())
        points += [(column, float(part[index])) for index in sorted((least, most))]
    return points
