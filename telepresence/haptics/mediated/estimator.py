"""Estimates the wall that the robot's tip touches, from positions and measured forces.

In contact, force = stiffness * (position - surface) + damping * velocity. The three unknowns are
found by least squares over the samples of a contact in which the tip moved; older ones count less
and less. A tip that only slows down does not tell them; then the place where the contact began is
taken for the surface. The free tip contradicts a wall when it stands behind its surface.

Model-mediated teleoperation: P. Mitra, G. Niemeyer, "Model-mediated telemanipulation", Int. J.
Robotics Research 27, 2008; C. Passenberg, A. Peer, M. Buss, "A survey of environment-, operator-,
and task-adapted controllers for teleoperation systems", Mechatronics 20, 2010.
"""

from dataclasses import dataclass

from kontur_av.clock import NS_PER_MS, NS_PER_S
from telepresence.haptics.mediated.wall import (
    LEAST_STIFFNESS_N_M,
    MOST_STIFFNESS_N_M,
    Wall,
    WallMessage,
    pack_wall,
)

#: A standard deviation of velocity below which damping does not matter.
_SLOW_M_S = 0.0005
#: Position and velocity are told apart if their correlation, squared, is below 1 less this.
_APART = 0.05
#: The place where a contact began is coarse: the mean depth must be so many times the least spread.
_DEEP = 5.0


@dataclass(frozen=True, kw_only=True, slots=True)
class EstimatorModel:
    """Parameters of the estimate; all of them chosen.

    least_n: a smaller force is not looked at.
    step_m: the tip must move by this for its next sample.
    samples, spread_m: an estimate needs so many samples, with this standard deviation of position.
    keep: weight of a sample after the next one.
    behind_m: a free tip so far behind the surface says that there is no wall.
    moved_m, changed: a change of the surface, and a relative one of the stiffness, that is told.
    apart_ns: the least time between two messages. repeat_ns: the time to the next without a change.
    """

    least_n: float = 0.05
    step_m: float = 20e-6
    samples: int = 6
    spread_m: float = 0.1e-3
    keep: float = 0.97
    behind_m: float = 0.002
    moved_m: float = 0.0002
    changed: float = 0.1
    apart_ns: int = 100 * NS_PER_MS
    repeat_ns: int = NS_PER_S


class WallEstimator:
    """Call `handle_sample` once a cycle, and send what `poll_transmit` returns.

    wall: the present estimate, or None. told: the one of the newest message. sent: messages so far.
    """

    def __init__(self, model: EstimatorModel | None = None) -> None:
        self.model = model or EstimatorModel()
        self.wall: Wall | None = None
        self.sent = 0
        self.told: Wall | None = None
        self._changed = False
        #: The next message is due, and the earliest instant of one after a change.
        self._due_ns: int | None = None
        self._earliest_ns = 0
        self._last: tuple[int, float, float] | None = None
        #: Axis and inward sign of the present contact.
        self._axis = self._inward = 0
        #: Where this contact began, if the tip was free before.
        self._entered: tuple[float, float] | None = None
        self._free = False
        self._used_m: float | None = None
        self._sums = _Sums(self.model.keep)

    def handle_sample(
        self, now_ns: int, x_m: float, y_m: float, fx_n: float, fy_n: float, contact: bool
    ) -> None:
        """Take the force (N) that the board exerts on the tip at (x_m, y_m), measured at `now_ns`.

        contact: the tip touches something.
        """
        last, self._last = self._last, (now_ns, x_m, y_m)
        if not contact:
            self._axis = self._inward = 0
            self._free, self._entered = True, None
            wall = self.wall
            if wall is not None and wall.depth_m(x_m, y_m) > self.model.behind_m:
                self.wall, self._changed = None, self.told is not None
            return
        if last is None or now_ns <= last[0]:
            return
        if self._free:
            # The surface lies between the last free place and the first one in contact.
            self._free, self._entered = False, ((last[1] + x_m) / 2.0, (last[2] + y_m) / 2.0)
        force = max(abs(fx_n), abs(fy_n))
        if force < self.model.least_n:
            return
        if not self._inward:
            self._axis = 0 if abs(fx_n) >= abs(fy_n) else 1
            self._inward = -1 if (fy_n if self._axis else fx_n) > 0.0 else 1
            self._sums, self._used_m = _Sums(self.model.keep), None
        # Along the motion that meets the wall, so that depth and force are positive.
        at_m, before_m, push_n = (y_m, last[2], fy_n) if self._axis else (x_m, last[1], fx_n)
        at_m, before_m, push_n = (
            at_m * self._inward,
            before_m * self._inward,
            -push_n * self._inward,
        )
        if self._used_m is not None and abs(at_m - self._used_m) < self.model.step_m:
            return
        self._used_m = at_m
        self._sums.add(at_m, (at_m - before_m) * NS_PER_S / (now_ns - last[0]), push_n)
        self._estimate()

    def handle_shift(self, x_m: float, y_m: float) -> None:
        """All coordinates grow by (x_m, y_m), so the wall does; a contact begins anew."""
        self._axis = self._inward = 0
        self._free, self._entered, self._last = False, None, None
        if self.wall is not None:
            self.wall, self._changed = self.wall.moved(x_m, y_m), True

    def tell_again(self) -> None:
        """The joystick has started: it knows no wall."""
        self._due_ns, self._earliest_ns = None, 0

    def poll_transmit(self, now_ns: int) -> bytes | None:
        """Return the message to send now, or None. Without a change it is repeated, rarely.

        Nothing is sent before a contact: a robot that has just started denies no wall.
        """
        if self.wall is None and self.told is None and not self._changed:
            return None
        due_ns = self._due_ns
        if due_ns is not None and now_ns < (self._earliest_ns if self._changed else due_ns):
            return None
        data = pack_wall(WallMessage(now_ns // NS_PER_MS, self.wall), self.sent)
        self.sent += 1
        self.told, self._changed = self.wall, False
        self._earliest_ns = now_ns + self.model.apart_ns
        self._due_ns = now_ns + self.model.repeat_ns
        return data

    def _estimate(self) -> None:
        model = self.model
        if self._sums.number < model.samples:
            return
        entered = self._entered
        entered_m = None if entered is None else self._inward * entered[self._axis]
        found = self._sums.solve(model.spread_m, entered_m)
        if found is None:
            return
        stiffness, surface_m = found
        if not LEAST_STIFFNESS_N_M <= stiffness <= MOST_STIFFNESS_N_M:
            return
        self.wall = wall = Wall(self._axis, self._inward, self._inward * surface_m, stiffness)
        told = self.told
        self._changed = (
            told is None
            or (told.axis, told.inward) != (wall.axis, wall.inward)
            or abs(told.surface_m - wall.surface_m) > model.moved_m
            or abs(told.stiffness_n_m - stiffness) > model.changed * told.stiffness_n_m
        )


class _Sums:
    """Least squares of force = stiffness * (position - surface) + damping * velocity."""

    def __init__(self, keep: float) -> None:
        self.number = 0
        self._keep = keep
        self._weight = 0.0
        self._mean = [0.0, 0.0, 0.0]
        #: Sums of products of deviations: xx, xv, vv, xf, vf.
        self._products = [0.0] * 5

    def add(self, x: float, v: float, f: float) -> None:
        """Count a sample: position (m), velocity (m/s), force (N)."""
        self.number += 1
        keep = self._keep
        before = self._weight * keep
        self._weight = before + 1.0
        mean = self._mean
        dx, dv, df = x - mean[0], v - mean[1], f - mean[2]
        share = 1.0 / self._weight
        mean[0] += dx * share
        mean[1] += dv * share
        mean[2] += df * share
        # Deviations from the old means, so the products stay exact (West 1979).
        gain = before * share
        xx, xv, vv, xf, vf = self._products
        self._products = [
            keep * xx + gain * dx * dx,
            keep * xv + gain * dx * dv,
            keep * vv + gain * dv * dv,
            keep * xf + gain * dx * df,
            keep * vf + gain * dv * df,
        ]

    def solve(self, spread_m: float, entered_m: float | None) -> tuple[float, float] | None:
        """Return stiffness (N/m) and surface (m), or None if the samples do not tell them.

        entered_m: where the contact began; it is taken for the surface if the samples alone do not
        tell the shares of stiffness and damping, as while a tip only slows down.
        """
        xx, xv, vv, xf, vf = self._products
        if xx < self._weight * spread_m * spread_m:
            return None
        x, v, f = self._mean
        if vv < self._weight * _SLOW_M_S * _SLOW_M_S:
            stiffness, damping = xf / xx, 0.0
        else:
            whole = xx * vv - xv * xv
            if whole < _APART * xx * vv:
                return None if entered_m is None else self._solve_from(spread_m, entered_m)
            stiffness = (xf * vv - vf * xv) / whole
            damping = (vf * xx - xf * xv) / whole
        if stiffness <= 0.0:
            return None
        return stiffness, x - (f - damping * v) / stiffness

    def _solve_from(self, spread_m: float, entered_m: float) -> tuple[float, float] | None:
        """Like `solve`, with the surface where the contact began."""
        weight, (x, v, f) = self._weight, self._mean
        depth = x - entered_m
        if depth < _DEEP * spread_m:
            return None
        xx, xv, vv, xf, vf = self._products
        xx += weight * depth * depth
        xv += weight * depth * v
        vv += weight * v * v
        xf += weight * depth * f
        vf += weight * v * f
        whole = xx * vv - xv * xv
        if whole < _APART * xx * vv:
            return None
        stiffness = (xf * vv - vf * xv) / whole
        return (stiffness, entered_m) if stiffness > 0.0 else None
