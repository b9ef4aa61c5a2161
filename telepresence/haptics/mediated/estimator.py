"""Estimates the wall that the robot's tip touches, from positions and measured forces.

The wall is taken for a plane, slightly curved, where the tip is. Along the plane's normal,

    force = stiffness * depth + damping * velocity,
    depth = u - surface + tilt * w - curvature * w^2 / 2.

u and w are the position across and along the assumed plane, from the newest place of the tip. The
force along the plane says the same tilt, and friction, which turns with the sliding direction:

    force along = force * (tilt - curvature * w + friction * sliding).

The six unknowns are found together by least squares over the samples of a contact in which the tip
moved; older ones count less and less. The assumed plane is then turned by the tilt. What the
samples do not tell comes from weak priors, and from the place where the contact began. An estimate
that is too uncertain is not told. The free tip contradicts a wall when it stands behind its
surface. docs/haptics.md has the figures, and what is sent of the measured force.

Model-mediated teleoperation: P. Mitra, G. Niemeyer, "Model-mediated telemanipulation", Int. J.
Robotics Research 27, 2008; C. Passenberg, A. Peer, M. Buss, "A survey of environment-, operator-,
and task-adapted controllers for teleoperation systems", Mechatronics 20, 2010.
"""

from collections import deque
from dataclasses import dataclass
from math import atan, atan2, cos, hypot, inf, sin, tau

import numpy as np

from kontur_av.clock import NS_PER_MS, NS_PER_S
from telepresence.haptics.mediated.wall import (
    LEAST_STIFFNESS_N_M,
    MOST_STIFFNESS_N_M,
    Wall,
    WallMessage,
    pack_wall,
)

#: A place that nobody measured lies somewhere in its interval: its standard deviation by length.
_UNIFORM = 12.0**-0.5
#: Deviation of the force (N) about the model before there are residuals.
_FIRST_N = 0.05
#: A solution is improved until the assumed plane turned by less than this (rad), and the variance
#: grew by a smaller factor, so many times at most.
_TURNED_RAD, _TRUSTED, _TURNS = 0.01, 2.0, 4


@dataclass(frozen=True, kw_only=True, slots=True)
class EstimatorModel:
    """Parameters of the estimate; all of them chosen.

    least_n: a smaller force is not looked at.
    step_m: the tip must move by this for its next sample; further in a contact that is too soft for
    such short ways to tell its stiffness.
    samples: an estimate needs so many, and looks at `most_samples`.
    keep: weight of a sample after the next one.
    noise_n: standard deviation of the measured force, at least.
    friction, friction_spread, curvature_spread, damping_spread: what walls are like: mean and
    standard deviation of the friction, deviations of curvature (1/m) and damping (N s/m) from 0.
    learned, stiffness_spread: a stiffness that the samples tell with a relative deviation below
    `learned` is expected in the rest of the contact, too, with the other one.
    slide_m_s: friction is half of its whole at this speed along the wall.
    misfit_n: samples that differ more from every plane are forgotten.
    slips: the largest friction. A wall that needs a larger mean share of the force along it is not
    told.
    uncertain, uncertain_rad: an estimate with a larger standard deviation of the stiffness,
    relative, or of the angle is not told.
    estimate_ns: the least time between two estimates.
    behind_m: a free tip so far behind the surface says that there is no wall.
    moved_m, changed, turned_rad: a change of the surface at the tip, a relative one of the
    stiffness, and one of the angle, that is told.
    apart_ns: the least time between two messages. repeat_ns: the time to the next without a change;
    pressed_ns, unheard_ns: while the tip touches something, and while no joystick is heard then. A
    joystick that starts meanwhile soon has the wall. first: after a start of either end, so many
    messages are `apart_ns` apart, because some are lost.
    """

    least_n: float = 0.05
    step_m: float = 20e-6
    samples: int = 6
    most_samples: int = 96
    keep: float = 0.97
    noise_n: float = 0.02
    friction: float = 0.1
    friction_spread: float = 0.1
    curvature_spread: float = 25.0
    damping_spread: float = 50.0
    stiffness_spread: float = 0.05
    learned: float = 0.03
    slide_m_s: float = 0.005
    misfit_n: float = 0.5
    slips: float = 0.6
    uncertain: float = 0.15
    uncertain_rad: float = 0.1
    estimate_ns: int = 10 * NS_PER_MS
    behind_m: float = 0.002
    moved_m: float = 0.0002
    changed: float = 0.1
    turned_rad: float = 0.03
    apart_ns: int = 100 * NS_PER_MS
    repeat_ns: int = NS_PER_S
    pressed_ns: int = 500 * NS_PER_MS
    unheard_ns: int = 250 * NS_PER_MS
    first: int = 5


class WallEstimator:
    """Call `handle_sample` once a cycle, and send what `poll_transmit` returns.

    wall: the present estimate, or None. told: the one of the newest message. sent: messages so far.
    """

    def __init__(self) -> None:
        self.model = EstimatorModel()
        self.wall: Wall | None = None
        self.sent = 0
        self.told: Wall | None = None
        self._changed = False
        #: When the newest message was sent; None: the next one is due.
        self._sent_ns: int | None = None
        self._first = self.model.first
        self._last: tuple[int, float, float] | None = None
        self._free = False
        #: Position, velocity and force of the samples of this contact, the newest last.
        self._samples: deque[tuple[complex, complex, complex]] = deque(
            maxlen=self.model.most_samples
        )
        self._estimate_ns = 0
        self._begin()

    def _begin(self) -> None:
        self._samples.clear()
        self._used = 0
        self._step_m = self.model.step_m
        #: Deviation of the place where it began; that place, velocity and force there.
        self._entered: tuple[float, complex, complex, complex] = (inf, 0j, 0j, 0j)
        #: The assumed plane's angle and stiffness; the variance of the force about the model.
        self._angle_rad: float | None = None
        self._stiffness = 1000.0
        self._variance = _FIRST_N**2
        #: The stiffness, once the samples of this contact have told it well.
        self._known_n_m: float | None = None

    def handle_sample(
        self, now_ns: int, x_m: float, y_m: float, fx_n: float, fy_n: float, contact: bool
    ) -> None:
        """Take the force (N) that the board exerts on the tip at (x_m, y_m), measured at `now_ns`.

        contact: the tip touches something.
        """
        last, self._last = self._last, (now_ns, x_m, y_m)
        model, samples = self.model, self._samples
        if not contact:
            self._free = True
            self._begin()
            wall = self.wall
            if wall is not None and wall.depth_m(x_m, y_m) > model.behind_m:
                self.wall, self._changed = None, self.told is not None
            return
        if last is None or now_ns <= last[0]:
            return
        dx, dy = x_m - last[1], y_m - last[2]
        if self._free:
            # The surface lies between the last free place and the first one in contact.
            position = complex(x_m - dx / 2.0, y_m - dy / 2.0)
            self._free, self._entered = False, (hypot(dx, dy) * _UNIFORM, position, 0j, 0j)
        if abs(fx_n) + abs(fy_n) < model.least_n:
            return
        position = complex(x_m, y_m)
        if samples and abs(position - samples[-1][0]) < self._step_m:
            return
        velocity = complex(dx, dy) * NS_PER_S / (now_ns - last[0])
        samples.append((position, velocity, complex(fx_n, fy_n)))
        self._used += 1
        if len(samples) >= model.samples and now_ns >= self._estimate_ns:
            self._estimate_ns = now_ns + model.estimate_ns
            self._estimate()

    def handle_shift(self, x_m: float, y_m: float) -> None:
        """All coordinates grow by (x_m, y_m), so the wall does; a contact begins anew."""
        self._free, self._last = False, None
        self._begin()
        if self.wall is not None:
            self.wall, self._changed = self.wall.moved(x_m, y_m), True

    def publish_again(self) -> None:
        """The joystick may have started: it knows no wall."""
        self._first = self.model.first

    def poll_transmit(self, now_ns: int, *, heard: bool = True) -> bytes | None:
        """Return the message to send now, or None. Without a change it is repeated, rarely.

        heard: the joystick is.

        Nothing is sent before a contact: a robot that has just started denies no wall.
        """
        if self.wall is None and self.told is None and not self._changed:
            return None
        model = self.model
        if self._changed or self._first > 0:
            wait_ns = model.apart_ns
        elif self._free:
            wait_ns = model.repeat_ns
        else:
            wait_ns = model.pressed_ns if heard else model.unheard_ns
        if self._sent_ns is not None and now_ns < self._sent_ns + wait_ns:
            return None
        data = pack_wall(WallMessage(now_ns // NS_PER_MS, self.wall), self.sent)
        self.sent += 1
        self.told, self._changed = self.wall, False
        self._sent_ns, self._first = now_ns, self._first - 1
        return data

    def _estimate(self) -> None:
        model, found = self.model, self._solve()
        if found is None:
            return
        self.wall = wall = found
        told = self.told
        tip = self._samples[-1][0]
        x_m, y_m = tip.real, tip.imag
        stiffness = wall.stiffness_n_m
        self._changed = (
            told is None
            or abs((wall.angle_rad - told.angle_rad + tau / 2) % tau - tau / 2) > model.turned_rad
            or abs(told.depth_m(x_m, y_m) - wall.depth_m(x_m, y_m)) > model.moved_m
            or abs(told.stiffness_n_m - stiffness) > model.changed * told.stiffness_n_m
        )

    def _solve(self) -> Wall | None:
        """Return the wall that explains the samples, or None if they do not tell it well."""
        model, known = self.model, self._known_n_m
        deviation_m, *entered = self._entered
        # Complex numbers, so that one product turns them into the assumed plane's frame.
        position, velocity, force = np.array([entered, *self._samples]).T
        tip = position[-1]
        ages = model.keep ** np.arange(len(position) - 1, -1, -1.0)
        ages[0] = model.keep**self._used
        angle = self._angle_rad
        if angle is None:
            mean = -(ages @ force)
            angle = atan2(mean.imag, mean.real)
        for _ in range(_TURNS):
            inward, k, variance = _unit(angle), self._stiffness, self._variance
            back = inward.conjugate()
            at, speed, load = back * (position - tip), back * velocity, -back * force
            w, push = at.imag, load.real
            slide = speed.imag / (np.abs(speed.imag) + model.slide_m_s)
            none = np.zeros_like(w)
            across = np.array([at.real, none - 1.0, speed.real, k * w, none, -0.5 * k * w * w])
            beside = np.array([none, none, none, push, push * slide, -push * w])
            weights = ages.copy()
            # Where the contact began there is no force, but that place is coarse.
            weights[0] *= variance / (variance + (k * deviation_m) ** 2)
            normal = (across * weights) @ across.T + (beside * weights) @ beside.T
            right = across @ (weights * push) + beside @ (weights * load.imag)
            priors = [
                (2, 0.0, model.damping_spread),
                (4, model.friction, model.friction_spread),
                (5, 0.0, model.curvature_spread),
            ]
            if known is not None:
                priors.append((0, known, model.stiffness_spread * known))
            for index, mean, spread in priors:
                normal[index, index] += variance / spread**2
                right[index] += mean * variance / spread**2
            try:
                covariance = variance * np.linalg.inv(normal)
            except np.linalg.LinAlgError:
                return None
            solution = covariance @ right / variance
            stiffness, surface, _, tilt, *_ = map(float, solution)
            if not LEAST_STIFFNESS_N_M <= stiffness <= MOST_STIFFNESS_N_M or abs(tilt) > 1.0:
                return None
            missing = (solution @ across - push) ** 2 + (solution @ beside - load.imag) ** 2
            self._variance = max(model.noise_n**2, float(weights @ missing / weights.sum()) / 2.0)
            self._stiffness, angle = stiffness, angle + atan(tilt)
            if abs(tilt) < _TURNED_RAD and self._variance < _TRUSTED * variance:
                break
        if self._variance > model.misfit_n**2:
            # The wall moved, or another one was met: what was before tells nothing of it.
            self._begin()
            return None
        if abs(ages @ load.imag) > model.slips * (ages @ push):
            # Friction below that does not turn the force so far: begin from its direction again.
            self._angle_rad = None
            return None
        self._angle_rad = angle
        uncertain_2 = float(covariance[0, 0]) / stiffness**2
        if not 0.0 < uncertain_2 <= model.uncertain**2 or covariance[3, 3] > model.uncertain_rad**2:
            if len(self._samples) == model.most_samples:
                self._step_m *= 2.0
                for _ in range(model.most_samples // 2):
                    self._samples.popleft()
                    self._samples.rotate(-1)
            return None
        # What the samples alone tell of the stiffness.
        told_2 = 1.0 / uncertain_2
        if known is not None:
            told_2 -= (stiffness / (model.stiffness_spread * known)) ** 2
        if told_2 * model.learned**2 > 1.0:
            self._known_n_m = stiffness
        at_surface = tip + surface / stiffness * inward
        distance_m = (_unit(-angle) * at_surface).real
        return Wall(angle % tau, float(distance_m), stiffness)


def _unit(angle_rad: float) -> complex:
    return complex(cos(angle_rad), sin(angle_rad))


#: A wall takes over within this time, about as fast as the renderer lets its force grow.
_TAKES_OVER_NS = 300 * NS_PER_MS
#: Time constants of the tip's velocity and of what its force has of late had to do with it.
_VELOCITY_S, _LATELY_S = 0.005, 0.3
#: A slower tip (m/s) tells nothing of a damping.
_SLOW_M_S = 0.0002


class Residual:
    """Call `rest_n` once a cycle with the newest wall that was told, or None.

    What goes with the tip's velocity, such as friction and the wall's damping, is no part of the
    rest. It brings the tip to rest, but shown a round trip late it would keep a hand swinging.
    """

    def __init__(self) -> None:
        self._share = 0.0
        self._last: tuple[int, complex] | None = None
        self._velocity = 0j
        #: Means of force times velocity, and of velocity squared: across the wall, along it.
        self._brakes, self._moves = [0.0, 0.0], [0.0, 0.0]

    def rest_n(
        self,
        wall: Wall | None,
        x_m: float,
        y_m: float,
        fx_n: float,
        fy_n: float,
        now_ns: int,
    ) -> tuple[float, float]:
        """Return the part of the force (fx_n, fy_n) on the tip that `wall` does not explain."""
        last, self._last = self._last, (now_ns, complex(x_m, y_m))
        passed_s = max(0, now_ns - last[0]) / NS_PER_S if last is not None else 0.0
        if last is not None and passed_s > 0.0:
            moved = self._last[1] - last[1]
            self._velocity += (moved - self._velocity * passed_s) / (passed_s + _VELOCITY_S)
        if wall is None:
            self._share = 0.0
            self._brakes, self._moves = [0.0, 0.0], [0.0, 0.0]
            return fx_n, fy_n
        self._share = min(1.0, self._share + passed_s * NS_PER_S / _TAKES_OVER_NS)
        inward = complex(*wall.inward)
        rest = complex(fx_n, fy_n) - self._share * complex(*wall.force_n(x_m, y_m))
        back = inward.conjugate()
        velocity, load = self._velocity * back, rest * back
        lately = passed_s / (passed_s + _LATELY_S)
        braking = []
        for axis, (v, f) in enumerate(((velocity.real, load.real), (velocity.imag, load.imag))):
            self._brakes[axis] += (-f * v - self._brakes[axis]) * lately
            self._moves[axis] += (v * v - self._moves[axis]) * lately
            gain = max(0.0, self._brakes[axis]) / (self._moves[axis] + _SLOW_M_S * _SLOW_M_S)
            braking.append(gain * v)
        rest += self._share * complex(*braking) * inward
        return rest.real, rest.imag
