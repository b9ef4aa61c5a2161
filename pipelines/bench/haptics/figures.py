"""What a run of a cell comes to: figures out of what the plants really did."""

from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from pipelines.bench.haptics.cell import Cell
from pipelines.bench.haptics.plan import DEPTH_M, Plan
from telepresence.haptics.robot import RobotModel
from telepresence.haptics.robot_controller import RobotControllerModel

#: A hand that keeps still on a wall feels a still force. A swing beyond this (N, peak to peak)
#: that does not fade is an oscillation: a quarter of the press on the softest wall of the grids,
#: all of which an unstable loop gives and takes.
SWING_N = 2.0
#: It fades if the last third of the hold swings less than this share of the middle third.
FADES = 0.7

Values = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Trace:
    """A run, one value a millisecond. Positions in m, forces in N, energies in J.

    handle, tip, reference: (n, 2): what the hand holds, what touches the wall, what pulls the
    tip. displayed, drive: (n, 2), the forces of the network on the handle and on the tip.
    contact_n: what the wall gives back. joystick_observed_j, robot_observed_j: of the observers.
    joystick_given_j, robot_given_j: what the network has given out at its ends, net, by force and
    displacement of handle and tip: no observer has a part in it.
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


@dataclass(frozen=True, kw_only=True, slots=True)
class Figures:
    """Energies in µJ, forces in N, force changes in N/ms, positions in mm.

    least_joystick_uj, least_robot_uj: least energy that the observers saw, below 0: the port gave
    more than had come in at the other. given_uj: most that the network had given out in all, at
    any instant, above 0: it made energy. contact_peak_n, displayed_peak_n: the largest forces
    of the wall and on the handle; contact_bound_n: see `contact_bound_n`. swing_n: of both forces
    in the last third of the hold, middle_swing_n: in the middle third. felt: the mean force on
    the handle over that of the wall in the last third. rise_n_ms, drop_n_ms: the largest growth
    and the largest fall of the force on the handle from one cycle to the next. drift_mm: how far
    apart handle and tip are at the very end, at rest and free. touches: how often the wall was
    met. acted_joystick, acted_robot: cycles in which a controller took something away.
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
    felt: float
    rise_n_ms: float
    drop_n_ms: float
    drift_mm: float
    touches: int
    acted_joystick: int
    acted_robot: int

    @property
    def unstable(self) -> bool:
        """It swings on although the hand keeps still."""
        return self.swing_n > SWING_N and self.swing_n > FADES * self.middle_swing_n


def figures(
    cell: Cell, plan: Plan, trace: Trace, *, passive: bool, acted: tuple[int, int]
) -> Figures:
    """The figures of one run."""
    begin, end = (instant // 1_000_000 for instant in plan.hold_ns)
    third = (end - begin) // 3
    contact = trace.contact_n > 0.0
    # The last tenth of a second: hand and tip have been at rest for long.
    apart = trace.handle[-100:] - trace.tip[-100:]
    sizes = np.hypot(*trace.displayed.T)
    changes = np.diff(sizes)
    pressed_n = float(trace.contact_n[end - third : end].mean())
    return Figures(
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
        felt=float(sizes[end - third : end].mean()) / pressed_n if pressed_n else 0.0,
        rise_n_ms=float(changes.max()),
        drop_n_ms=float(-changes.min()),
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
    """The largest force (N) with which a tip that only follows the hand can press this wall.

    It is the press when the hand is as deep behind the wall as it means to be (the controller's
    spring and the wall in series), and on top of that the blow of the tip's mass at the greatest
    speed of the reference, v * sqrt(k * m) of an undamped wall.
    """
    robot_side, robot = RobotControllerModel(), RobotModel()
    spring = robot_side.stiffness_n_m * wall_n_m / (robot_side.stiffness_n_m + wall_n_m)
    return DEPTH_M * spring + robot_side.speed_m_s * sqrt(wall_n_m * robot.mass_kg)
