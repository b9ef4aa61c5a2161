"""What a run of a cell comes to: figures out of what the plants really did."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipelines.bench.haptics_cell import Cell
from pipelines.bench.haptics_plan import Plan

#: A hand that keeps still on a wall feels a still force: a swing beyond this (N, peak to peak)
#: that does not fade is an oscillation. It is a fifth of the smallest peak that a press gives.
SWING_N = 1.0
#: It fades if the last third of the hold swings less than this share of the middle third.
FADES = 0.7

Values = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Trace:
    """A run, one value a millisecond. Positions in m, forces in N, energies in J.

    handle, tip, reference: (n, 2): what the hand holds, what touches the wall, what pulls the
    tip. displayed, drive: (n, 2), the forces of the network on the handle and on the tip.
    contact_n: what the wall gives back. master_observed_j, slave_observed_j: of the observers.
    master_given_j, slave_given_j: what the network has given out at its ends, net, by force and
    displacement of handle and tip: no observer has a part in it.
    """

    handle: Values
    tip: Values
    displayed: Values
    drive: Values
    contact_n: Values
    master_observed_j: Values
    slave_observed_j: Values
    master_given_j: Values
    slave_given_j: Values


@dataclass(frozen=True, kw_only=True, slots=True)
class Figures:
    """Energies in µJ, forces in N, force changes in N/ms, positions in mm.

    least_master_uj, least_slave_uj: least energy that the observers saw, below 0: the port gave
    more than had come in at the other. given_uj: most that the network had given out in all, at
    any instant, above 0: it made energy. contact_peak_n, displayed_peak_n: the largest forces
    of the wall and on the handle. swing_n: of both forces in the last third of the hold,
    middle_swing_n: in the middle third. jump_n_ms: the largest change of the force on the
    handle from one cycle to the next; drive_jump_n_ms: of the force on the tip. drift_mm: how
    far apart handle and tip are at the very end, at rest and free. touched: of the handle.
    acted_master, acted_slave: cycles in which a controller took something away.
    """

    cell: Cell
    passive: bool
    least_master_uj: float
    least_slave_uj: float
    given_uj: float
    contact_peak_n: float
    displayed_peak_n: float
    swing_n: float
    middle_swing_n: float
    jump_n_ms: float
    drive_jump_n_ms: float
    drift_mm: float
    touches: int
    acted_master: int
    acted_slave: int

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
    return Figures(
        cell=cell,
        passive=passive,
        least_master_uj=1e6 * float(trace.master_observed_j.min()),
        least_slave_uj=1e6 * float(trace.slave_observed_j.min()),
        given_uj=1e6 * float((trace.master_given_j + trace.slave_given_j).max()),
        contact_peak_n=float(trace.contact_n.max()),
        displayed_peak_n=float(np.hypot(*trace.displayed.T).max()),
        swing_n=_swing(trace, end - third, end),
        middle_swing_n=_swing(trace, end - 2 * third, end - third),
        jump_n_ms=_jump(trace.displayed),
        drive_jump_n_ms=_jump(trace.drive),
        drift_mm=1e3 * float(np.hypot(*apart.T).max()),
        touches=int(np.count_nonzero(contact[1:] & ~contact[:-1])),
        acted_master=acted[0],
        acted_slave=acted[1],
    )


def _swing(trace: Trace, begin: int, end: int) -> float:
    """Peak to peak (N) of the wall's force and of both axes of the displayed force."""
    swings = [np.ptp(trace.contact_n[begin:end]), *np.ptp(trace.displayed[begin:end], axis=0)]
    return float(max(swings))


def _jump(force: Values) -> float:
    return float(np.hypot(*np.diff(force, axis=0).T).max())
