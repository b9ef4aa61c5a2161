"""The lead of force over its picture as stacked bars: a segment for each term."""

from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np

from kontur_av.errors import ConfigError
from pipelines.bench.plot import BLACK, COLOURS, GREY, tick_step, write_text
from pipelines.report.terms import TERMS

_WIDTH = 1100
_LEFT, _RIGHT, _TOP, _BOTTOM = 210, 70, 60, 120
_BAR, _PITCH = 40, 70
#: A segment shorter than its figure is left without.
_LABEL_PIXELS = 34
_LEGEND_PIXELS = 200
_LIMIT = (60, 60, 200)


def plot_leads(
    path: Path, leads: Mapping[str, Mapping[str, float]], limits: Mapping[str, float]
) -> None:
    """Write a PNG with a bar for each of `leads`: label -> {term: ms, "total": ms}.

    limits: lines across all bars, label -> ms. A term below 0 has no segment; the figure at the end
    of a bar is the true total.
    """
    height = _TOP + _BOTTOM + _PITCH * max(1, len(leads))
    image = np.full((height, _WIDTH, 3), 255, np.uint8)
    title = "By how much force comes before the picture of the same event (mean, ms)"
    write_text(image, title, (20, 32), 0.65, BLACK)
    lengths = [sum(max(0.0, lead[term]) for term in TERMS) for lead in leads.values()]
    longest = max([*lengths, *limits.values(), 1.0])
    step = tick_step(longest)
    right = step * (int(longest / step) + 1)

    def at(value: float) -> int:
        return round(_LEFT + (_WIDTH - _LEFT - _RIGHT) * value / right)

    bottom = height - _BOTTOM
    for number in range(round(right / step) + 1):
        x = at(number * step)
        cv2.line(image, (x, _TOP), (x, bottom), GREY)
        write_text(image, f"{number * step:g}", (x - 8, bottom + 18), 0.45, BLACK)
    for row, (label, lead) in enumerate(leads.items()):
        y = _TOP + 15 + _PITCH * row
        write_text(image, label, (20, y + 26), 0.5, BLACK)
        begin = 0.0
        for term, colour in zip(TERMS, COLOURS, strict=True):
            value = max(0.0, lead[term])
            left, end = at(begin), at(begin + value)
            cv2.rectangle(image, (left, y), (end, y + _BAR), colour, cv2.FILLED)
            if end - left >= _LABEL_PIXELS:
                write_text(image, f"{value:.1f}", (left + 4, y + 25), 0.45, _ink(colour))
            begin += value
        write_text(image, f"{lead['total']:.1f}", (at(begin) + 6, y + 26), 0.55, BLACK)
    for label, value in limits.items():
        x = at(value)
        cv2.line(image, (x, _TOP - 12), (x, bottom), _LIMIT, 2)
        write_text(image, label, (x + 4, _TOP - 2), 0.4, _LIMIT)
    per_row = (_WIDTH - 40) // _LEGEND_PIXELS
    for number, (term, colour) in enumerate(zip(TERMS, COLOURS, strict=True)):
        x = 20 + _LEGEND_PIXELS * (number % per_row)
        y = bottom + 50 + 28 * (number // per_row)
        cv2.rectangle(image, (x, y - 12), (x + 16, y + 4), colour, cv2.FILLED)
        write_text(image, term, (x + 24, y + 2), 0.5, BLACK)
    if not cv2.imwrite(str(path), image):
        raise ConfigError(f"--plot {path}: cannot be written")


def _ink(colour: tuple[int, ...]) -> tuple[int, ...]:
    """White on what is dark, black on what is light (luma of ITU-R BT.601)."""
    blue, green, red = colour
    return BLACK if 0.114 * blue + 0.587 * green + 0.299 * red > 140 else (255, 255, 255)
