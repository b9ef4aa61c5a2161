"""Pictures of `kontur-av bench haptics`: courses of chosen cells, and the map of stability."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from kontur_av.errors import ConfigError
from pipelines.bench.haptics.cell import Cell
from pipelines.bench.haptics.figures import Trace, Values
from pipelines.bench.haptics.map import StabilityMap
from pipelines.bench.haptics.plan import Plan
from pipelines.bench.plot_series import Image, map_panel, series_panel

_PERIOD_S = 0.001


def plot(
    path: Path,
    courses: Sequence[tuple[Cell, Plan, Trace, Trace]],
    maps: Sequence[tuple[str, StabilityMap]],
) -> None:
    """Write a PNG: for each (cell, plan, trace without, trace with) three rows of two panels
    (without the controllers on the left, with them on the right), then the maps side by side."""
    rows = [row for course in courses for row in _course(*course)]
    if maps:
        rows.append(np.hstack([_map(title, found) for title, found in maps]))
    if not cv2.imwrite(str(path), np.vstack(rows)):
        raise ConfigError(f"--plot {path}: cannot be written")


def _course(cell: Cell, plan: Plan, without: Trace, with_: Trace) -> list[Image]:
    dark = [(begin / 1e9, end / 1e9) for begin, end in {*plan.down_dark, *plan.up_dark}]
    both = (("without", without), ("with", with_))
    # So that a run that makes energy does not flatten the other.
    most_j = max(1e-3, float(np.abs(_given(with_)).max()))
    panels = []
    for what, unit, limits, curves in (
        ("position", "mm", (-20.0, 100.0), _positions),
        ("force", "N", (-5.0, 35.0), _forces),
        ("energy", "mJ", (-2e3 * most_j, 2e3 * most_j), _energies),
    ):
        panels.append(
            np.hstack(
                [
                    series_panel(
                        f"{what} {name}: {cell.name}",
                        curves(trace),
                        period_s=_PERIOD_S,
                        unit=unit,
                        shaded_s=dark,
                        limits=limits,
                    )
                    for name, trace in both
                ]
            )
        )
    return panels


def _positions(trace: Trace) -> dict[str, Values]:
    return {"handle": 1e3 * trace.handle[:, 0], "tip": 1e3 * trace.tip[:, 0]}


def _forces(trace: Trace) -> dict[str, Values]:
    return {"wall on the tip": trace.contact_n, "on the handle": -trace.displayed[:, 0]}


def _given(trace: Trace) -> Values:
    return trace.joystick_given_j + trace.robot_given_j


def _energies(trace: Trace) -> dict[str, Values]:
    return {
        "observed by the joystick side": 1e3 * trace.joystick_observed_j,
        "observed by the robot side": 1e3 * trace.robot_observed_j,
        "given out by the network": 1e3 * _given(trace),
    }


def _map(title: str, found: StabilityMap) -> Image:
    good = [[not found.unstable(wall, delay)[0] for delay in found.delays] for wall in found.walls]
    return map_panel(
        f"{title}: cells that swing on, largest contact force",
        columns=[f"{delay:g} ms" for delay in found.delays],
        rows=[f"{wall / 1000:g} kN/m" for wall in found.walls],
        good=np.array(good),
        texts=[
            [
                "{}/{}, {:.0f} N".format(*found.unstable(wall, delay), found.peak_n(wall, delay))
                for delay in found.delays
            ]
            for wall in found.walls
        ],
    )
