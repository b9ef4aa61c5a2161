"""The figures of one run of a cell, all from motions and forces outside the controllers. A core.

Only the least observed energy is the controllers' own.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from benchmarks.haptics.cell import Cell
from benchmarks.haptics.plan import FELT_AFTER_S, FIRST, LAST, REST, START, CellPlan
from benchmarks.haptics.run import Course
from kontur_av.clock import NS_PER_MS
from telepresence.haptics.robot import RobotModel
from telepresence.haptics.robot_controller import RobotControllerModel

#: A hand that keeps still on a wall feels a constant force. A swing above this (N, peak to peak)
#: that does not fade is an oscillation; an unstable loop swings by all of the force.
SWING_N = 2.0
#: A swing fades if it is less than this share of the middle third in the last third of a hold.
FADES = 0.7
#: The largest change of the force on the hand in 1 ms that counts as smooth (N).
STEP_N = 1.1
#: Felt stiffness is a mean over so long (ms).
_MEAN_MS = 250
_FELT_MS = round(1000 * FELT_AFTER_S) + _MEAN_MS // 2
#: A smaller penetration (m) counts as this one, so that no stiffness is infinite.
_LEAST_M = 1e-4
#: Slower than this (m/s) a hand feels no drag.
_MOVES_M_S = 0.05

Values = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, slots=True)
class CellMetrics:
    """None: not in this cell.

    least_uj: least energy by the observers; below 0, a port gave out more than was granted.
    network_uj: the most that both ends together had given out; above 0, the network made energy.
    robot_uj: the most that the robot had got beyond what the motors had taken from the hand.
    motors_mj: the most that the motors had given the hand beyond what they had taken.

    contact_peak_n, displayed_peak_n: the largest forces of the wall and on the handle;
    contact_bound_n: see the function of that name. step_n_ms: largest change of the force on the
    handle in 1 ms, without those of a joystick that starts. swing_n: peak to peak of both forces in
    the last third of the hold and of the rest, middle_n in the middle third; not of a hand with a
    tremor.

    felt_first, felt_last, felt_restart: stiffness along the wall's normal over that of a coupling
    without delay (%), at the end of the first press of 1.5 s and three round trips, of the last
    one, and 1 s after a restart in contact. drag_early, drag_late: force against free motion of
    handle and tip over its speed (N s/m), in the first 3 s of motion and after 6 s. drift_mm:
    distance of handle and tip after 3 s of rest; of a hand with a tremor, which the tip follows
    with a delay, of their mean places over 1 s. touches: number of contacts; three are planned, and
    those of taps.
    """

    cell: Cell
    least_uj: float
    network_uj: float
    robot_uj: float
    motors_mj: float
    contact_peak_n: float
    contact_bound_n: float
    displayed_peak_n: float
    step_n_ms: float
    swing_n: float | None
    middle_n: float | None
    felt_first: float
    felt_last: float
    felt_restart: float | None
    drag_early: float | None
    drag_late: float | None
    drift_mm: float
    touches: int
    joystick_lives: int

    @property
    def unstable(self) -> bool:
        """Whether a force keeps oscillating although the hand keeps still."""
        swing_n, middle_n = self.swing_n or 0.0, self.middle_n or 0.0
        return swing_n > SWING_N and swing_n > FADES * middle_n


#: The figures of summaries: name, unit, and whether the smallest is the worst.
SUMMED: Mapping[str, tuple[str, str, bool]] = {
    "felt_first": ("felt, first press", "%", True),
    "felt_last": ("felt, last press", "%", True),
    "felt_restart": ("felt 1 s after restart", "%", True),
    "drag_early": ("drag, early", "N s/m", False),
    "drag_late": ("drag, late", "N s/m", False),
    "drift_mm": ("drift", "mm", False),
    "swing_n": ("swing", "N", False),
    "step_n_ms": ("step", "N/ms", False),
    "network_uj": ("network gave", "µJ", False),
    "robot_uj": ("robot beyond hand", "µJ", False),
    "motors_mj": ("motors gave", "mJ", False),
    "contact_peak_n": ("contact", "N", False),
    "touches": ("touches", "", False),
}


def metrics(cell: Cell, planned: CellPlan, course: Course) -> CellMetrics:
    """The figures of one run."""
    phases = np.array(planned.phases)[course["waypoint"].astype(int)]
    handle, motor, wall = (vectors(course, name) for name in ("handle", "motor", "wall"))
    contact = np.hypot(*wall.T)
    lives = np.diff(course["joystick_lives"], prepend=1.0) > 0.0
    starts = np.flatnonzero(lives | (np.diff(course["robot_lives"], prepend=1.0) > 0.0))
    felt_again = len(starts) > 0 and cell.at == "contact"
    wanted = handle + vectors(course, "offset")
    apart = wanted - vectors(course, "tip")
    normal = np.array(cell.normal)
    depth_m = wanted @ normal - cell.place / 1000.0
    shares = _felt(cell, depth_m, -(motor @ normal))

    def felt_until(end: int) -> float:
        return float(np.mean(shares[max(0, end - _MEAN_MS) : end]))

    first, last, rest = (_span(phases, phase) for phase in (FIRST, LAST, REST))
    taken_j = np.cumsum(np.maximum(-np.diff(course["motor_work"], prepend=0.0), 0.0))
    steps = np.hypot(*np.diff(motor, axis=0).T)
    steps[lives[1:]] = 0.0
    held = last[1] - planned.hold_ns // NS_PER_MS, last[1]
    swing_n, middle_n = max(_swing(motor, wall, span) for span in (held, rest))
    calm = not cell.bench_hand.tremor_n
    settled = rest[0] + round(1000 * cell.bench_hand.back_s) + 3000
    rested = apart[settled - 100 : settled] if calm else apart[settled - 1000 : settled].mean(0)
    early, late = _drags(cell, handle, depth_m, motor, contact, _span(phases, START)[1])
    credits = min(course[f"{end}_credit"].min() for end in ("joystick", "robot"))
    return CellMetrics(
        cell=cell,
        least_uj=1e6 * float(credits),
        network_uj=1e6 * float((course["motor_work"] + course["drive_work"]).max()),
        robot_uj=1e6 * float((course["drive_work"] - taken_j).max()),
        motors_mj=1e3 * float(course["motor_work"].max()),
        contact_peak_n=float(-(wall @ normal).min()),
        contact_bound_n=contact_bound_n(cell),
        displayed_peak_n=float(np.hypot(*motor.T).max()),
        step_n_ms=float(steps.max()),
        swing_n=swing_n if calm else None,
        middle_n=middle_n if calm else None,
        felt_first=felt_until(first[1]),
        felt_last=felt_until(last[1]),
        felt_restart=felt_until(int(starts[0]) + _FELT_MS) if felt_again else None,
        drag_early=early,
        drag_late=late,
        drift_mm=1e3 * float(np.hypot(*rested.T).max()),
        joystick_lives=int(course["joystick_lives"][-1]),
        touches=int(np.count_nonzero((contact[1:] > 0.0) & (contact[:-1] == 0.0))),
    )


def vectors(course: Course, name: str) -> Values:
    """The two columns of a position or a force, (n, 2)."""
    return np.stack((course[f"{name}_x"], course[f"{name}_y"]), axis=1)


def _span(phases: Values, phase: str) -> tuple[int, int]:
    """First row of the phase, and the one after its last."""
    rows = np.flatnonzero(phases == phase)
    return int(rows[0]), int(rows[-1]) + 1


def _felt(cell: Cell, depth_m: Values, against_n: Values) -> Values:
    """Felt stiffness over the ideal (%) in each millisecond."""
    felt: Values = against_n / np.maximum(depth_m, _LEAST_M) / series_n_m(cell.wall)
    return 100.0 * felt


def _swing(motor: Values, wall: Values, span: tuple[int, int]) -> tuple[float, float]:
    """Peak to peak (N) in the last and in the middle third of `span`."""
    begin, end = span
    third = (end - begin) // 3
    forces = np.hstack((motor, wall))
    parts = slice(end - third, end), slice(end - 2 * third, end - third)
    last, middle = (float(np.ptp(forces[part], axis=0).max()) for part in parts)
    return last, middle


def _drags(
    cell: Cell, handle: Values, depth_m: Values, motor: Values, contact: Values, begin: int
) -> tuple[float | None, float | None]:
    """Drag in the first 3 s from `begin` on, and after 6 s, far from any contact.

    A handle behind the surface feels the rendered wall, before the tip touches it.
    """
    velocity = np.diff(handle, axis=0) * 1000.0
    after = round(cell.delay + cell.jitter) + 300
    touched = np.convolve(contact > 0.0, np.ones(after))[: len(contact)] > 0.0
    free = ~touched[1:] & (depth_m[1:] <= 0.0) & (np.hypot(*velocity.T) > _MOVES_M_S)
    at = np.arange(len(velocity)) - begin
    # The force of a row moved the handle to its place in that row.
    power, speed = (motor[1:] * velocity).sum(axis=1), (velocity**2).sum(axis=1)
    early, late = (
        float(-power[part].sum() / speed[part].sum()) if part.any() else None
        for part in (free & (at >= 0) & (at < 3000), free & (at > 6000))
    )
    return early, late


def contact_bound_n(cell: Cell) -> float:
    """The largest force (N) of this wall on a tip that only follows the hand.

    Static, with the hand at its depth, and of an impact: v * sqrt(k * m), or v * d of a damper.
    """
    impact_n_s_m = max(sqrt(cell.wall * RobotModel().mass_kg), cell.damping)
    impact_n = RobotControllerModel().speed_m_s * impact_n_s_m
    return cell.bench_hand.depth_m * series_n_m(cell.wall) + impact_n


def series_n_m(wall_n_m: float) -> float:
    """The stiffness (N/m) of the controller's spring and the wall in series."""
    coupling_n_m = RobotControllerModel().stiffness_n_m
    return coupling_n_m * wall_n_m / (coupling_n_m + wall_n_m)
