"""The figures of one run of a cell, from the motion and forces of its plants. A core."""

from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from benchmarks.haptics.cell import Cell
from benchmarks.haptics.plan import DEPTH_M, CellPlan
from telepresence.haptics.board import WALL_X_M
from telepresence.haptics.robot import RobotModel
from telepresence.haptics.robot_controller import RobotControllerModel

#: A hand that keeps still on a wall feels a constant force. A swing above this (N, peak to peak)
#: that does not fade is an oscillation. It is a quarter of the force on the softest wall of the
#: grids; an unstable loop swings by all of that force.
SWING_N = 2.0
#: A swing fades if it is less than this share of the middle third in the last third of the hold.
FADES = 0.7

#: A smaller penetration (m) counts as this one, so that no stiffness is infinite.
_LEAST_M = 1e-4
#: Slower than this (m/s) a hand feels no drag.
_MOVES_M_S = 0.05
#: The largest change of the force on the hand in 1 ms that counts as smooth (N).
STEP_N = 1.1

Values = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Trace:
    """A run, one value a millisecond. Positions in m, forces in N, energies in J.

    handle, tip: (n, 2), positions of the joystick's handle and of the robot's tip. displayed,
    drive: (n, 2), the forces of the network on the handle and on the tip. contact_n: force of the
    wall. joystick_observed_j, robot_observed_j: energy by the passivity observers.
    joystick_given_j, robot_given_j: net energy that the network has given out at its ends, from
    force and displacement of handle and tip, without the observers. damping_n_s_m: of the
    controller at the joystick.
    """

    handle: Values
    tip: Values
    displayed: Values
    drive: Values
    contact_n: Values
    joystick_observed_j: Values
    robot_observed_j: Values
    joystick_given_j: Values
    robot_given_j: Values
    damping_n_s_m: Values


@dataclass(frozen=True, kw_only=True, slots=True)
class CellFigures:
    """Energies in µJ, forces in N, force changes in N/ms, positions in mm.

    least_joystick_uj, least_robot_uj: least energy by the observers; below 0, the port gave out
    more than the other port had taken in. given_uj: the most net energy that the network had given
    out at any instant; above 0, it made energy. contact_peak_n, displayed_peak_n: the largest
    forces of the wall and on the handle; contact_bound_n: see the function of that name. swing_n,
    middle_swing_n: peak to peak of both forces in the last and in the middle third of the hold.
    felt_n_m: mean force on the handle over the handle's penetration of the wall, in the last third.
    ideal_n_m: the same for a coupling without delay, its spring and the wall in series. drag_n_s_m:
    mean damping while the hand moves and the tip is free. rise_n_ms, drop_n_ms: the largest growth
    and fall of the force on the handle from one cycle to the next. drops: falls by more than
    `STEP_N`. drift_mm: distance of handle and tip at the end, at rest and free. touches: number of
    contacts.
    acted_joystick, acted_robot: cycles in which a passivity controller dissipated energy.
    """

    cell: Cell
    passive: bool
    least_joystick_uj: float
    least_robot_uj: float
    given_uj: float
    contact_peak_n: float
    contact_bound_n: float
    displayed_peak_n: float
    swing_n: float
    middle_swing_n: float
    felt_n_m: float
    ideal_n_m: float
    drag_n_s_m: float
    rise_n_ms: float
    drop_n_ms: float
    drops: int
    drift_mm: float
    touches: int
    acted_joystick: int
    acted_robot: int

    @property
    def unstable(self) -> bool:
        """Whether a force keeps oscillating although the hand keeps still."""
        return self.swing_n > SWING_N and self.swing_n > FADES * self.middle_swing_n

    @property
    def felt(self) -> float:
        """The felt stiffness over the ideal one."""
        return self.felt_n_m / self.ideal_n_m


def figures(
    cell: Cell, plan: CellPlan, trace: Trace, *, passive: bool, acted: tuple[int, int]
) -> CellFigures:
    """The figures of one run."""
    begin, end = (instant // 1_000_000 for instant in plan.hold_ns)
    third = (end - begin) // 3
    contact = trace.contact_n > 0.0
    # In the last tenth of a second hand and tip have been at rest for long.
    apart = trace.handle[-100:] - trace.tip[-100:]
    sizes = np.hypot(*trace.displayed.T)
    changes = np.diff(sizes)
    last = slice(end - third, end)
    penetration_m = float(trace.handle[last, 0].mean()) - WALL_X_M
    pressed_n = -float(trace.displayed[last, 0].mean())
    speeds = np.hypot(*np.diff(trace.handle, axis=0).T) * 1000.0
    free = (speeds > _MOVES_M_S) & ~contact[1:]
    return CellFigures(
        cell=cell,
        passive=passive,
        least_joystick_uj=1e6 * float(trace.joystick_observed_j.min()),
        least_robot_uj=1e6 * float(trace.robot_observed_j.min()),
        given_uj=1e6 * float((trace.joystick_given_j + trace.robot_given_j).max()),
        contact_peak_n=float(trace.contact_n.max()),
        contact_bound_n=contact_bound_n(cell.wall),
        displayed_peak_n=float(sizes.max()),
        swing_n=_swing(trace, end - third, end),
        middle_swing_n=_swing(trace, end - 2 * third, end - third),
        felt_n_m=pressed_n / max(penetration_m, _LEAST_M),
        ideal_n_m=series_n_m(cell.wall),
        drag_n_s_m=float(trace.damping_n_s_m[1:][free].mean()),
        rise_n_ms=float(changes.max()),
        drop_n_ms=float(-changes.min()),
        drops=int(np.count_nonzero(changes < -STEP_N)),
        drift_mm=1e3 * float(np.hypot(*apart.T).max()),
        touches=int(np.count_nonzero(contact[1:] & ~contact[:-1])),
        acted_joystick=acted[0],
        acted_robot=acted[1],
    )


def _swing(trace: Trace, begin: int, end: int) -> float:
    """Peak to peak (N) of the wall's force and of both axes of the displayed force."""
    swings = [np.ptp(trace.contact_n[begin:end]), *np.ptp(trace.displayed[begin:end], axis=0)]
    return float(max(swings))


def contact_bound_n(wall_n_m: float) -> float:
    """The largest force (N) of this wall on a tip that only follows the hand.

    It is the sum of two forces. The static one is that of the controller's spring and the wall in
    series, with the hand at its intended depth behind the wall. The impact is that of the
    tip's mass at the largest speed of the reference: v * sqrt(k * m) of an undamped wall.
    """
    robot_side, robot = RobotControllerModel(), RobotModel()
    impact_n = robot_side.speed_m_s * sqrt(wall_n_m * robot.mass_kg)
    return DEPTH_M * series_n_m(wall_n_m) + impact_n


def series_n_m(wall_n_m: float) -> float:
    """The stiffness (N/m) of the controller's spring and the wall in series."""
    coupling_n_m = RobotControllerModel().stiffness_n_m
    return coupling_n_m * wall_n_m / (coupling_n_m + wall_n_m)
