"""The controller at the joystick: it displays the robot's force and keeps that passive.

The port is the handle: the force that the motors hold for a cycle, and the way that the handle
goes in it. Both are known exactly one cycle later, so the observer is true in sampled time. What
the next cycle may give out is bounded beforehand: the handle goes on as it went, give or take what
its greatest acceleration makes of that in one cycle. If that could be more than the credit, the
part of the force along the motion is scaled down (a passivity controller of the impedance type).
Nothing is ever added, so there is no gain that could grow at low speed. What was cut comes back
slowly, and only along the force that is wanted by then.

The robot's force and the damping that the hand always feels are bounded one after the other. Were
only their sum bounded, a hand on its way back from a wall would pay with its damping for the force
that still pushes it along, and the robot would get nothing to follow it with.
"""

from dataclasses import dataclass
from math import sqrt

from kontur_av.clock import NS_PER_MS, NS_PER_S
from telepresence.haptics.passivity import Port, PortFigures
from telepresence.haptics.sample import Feedback

_CYCLE_S = NS_PER_MS / NS_PER_S
#: Half a count of the energy in a sample, which nobody can tell from none. Without it a hand that
#: begins slowly would feel no damping, give no energy, and so never begin to move the robot.
_ROUNDING_J = 0.5e-6


@dataclass(frozen=True, kw_only=True, slots=True)
class JoystickControllerModel:
    """Parameters of the controller at the joystick; all of them chosen.

    force_scale: displayed force over the robot's. damping_n_s_m: what the hand always feels; the
    energy that it takes out of the hand is what moves the robot while nothing is touched.
    rate_n_s: the displayed force grows no faster: no blow on resumption. relax_s: without samples
    it decays with this time constant. acceleration_m_s2: the handle never has more: it bounds how
    far the next cycle can differ from the last. horizon: the credit must last for so many cycles
    at the present speed, so that a force that can't be paid for fades instead of breaking off.
    reserved: of the reserve only this share pays for the force over a horizon: the rest is for the
    damping. regain_n_s: how fast a force comes back that was scaled down: faster, it would buzz.
    velocity_s: time constant of the velocity that the damping uses. reserve_j, limit_j: `Port`.
    keep_j, return_s: credit beyond the first goes back to the robot with this time constant: it
    moves what a hand at rest has no use for.
    """

    force_scale: float = 1.0
    damping_n_s_m: float = 4.0
    rate_n_s: float = 1000.0
    relax_s: float = 0.1
    acceleration_m_s2: float = 150.0
    horizon: float = 5.0
    velocity_s: float = 0.003
    reserved: float = 0.2
    regain_n_s: float = 30.0
    reserve_j: float = 0.004
    limit_j: float = 0.5
    keep_j: float = 0.02
    return_s: float = 0.5


class JoystickController(PortFigures):
    """`step` once a millisecond gives the force on the handle; it is held until the next step.

    passive: without, the same controller only observes. limit_n: of the force, by what the motors
    can give now; set it before a step. acted: cycles in which the passivity controller cut.
    """

    def __init__(
        self, model: JoystickControllerModel | None = None, *, passive: bool = True
    ) -> None:
        self.model = model = model or JoystickControllerModel()
        self.passive = passive
        self.port = (
            Port(reserve_j=model.reserve_j, limit_j=model.limit_j) if passive else Port.observing()
        )
        self.limit_n = 12.0
        self.acted = 0
        self._last: tuple[float, float] | None = None
        self._goal_x = self._goal_y = 0.0
        self._fx = self._fy = 0.0
        #: Of that, the robot's force.
        self._gx = self._gy = 0.0
        self._regaining = False
        self._vx = self._vy = 0.0
        # Looked up at once, not one by one: `step` is called a thousand times a second.
        self._constants = (
            model.force_scale,
            model.damping_n_s_m,
            model.rate_n_s,
            model.velocity_s,
            model.acceleration_m_s2 * _CYCLE_S * _CYCLE_S,
        )

    @property
    def robot_force_n(self) -> tuple[float, float]:
        """Of the force that is exerted now, the robot's; the rest is damping."""
        return self._gx, self._gy

    def handle_restart(self) -> None:
        """The peer began anew."""
        self.port.handle_restart()

    def step(
        self, feedback: Feedback | None, x_m: float, y_m: float, dt_ns: int
    ) -> tuple[float, float]:
        """The force on the handle (N, N) from now on, `dt_ns` after the step before.

        feedback: the newest sample, None if there is no fresh one. x_m, y_m: where the handle is.
        The first step gives none.
        """
        scale, damping, rate, velocity_s, margin = self._constants
        dt_s = dt_ns / NS_PER_S
        port, last = self.port, self._last
        self._last = (x_m, y_m)
        if last is None:
            # How fast the handle goes is not known yet, so what a force would cost isn't either.
            return 0.0, 0.0
        dx, dy = x_m - last[0], y_m - last[1]
        fx, fy = self._fx, self._fy
        port.handle_flow(fx * dx + fy * dy)
        if feedback is None:
            port.handle_silence(dt_ns)
        else:
            port.handle_total(feedback[2], dt_ns)
            surplus_j = port.credit_j - self.model.keep_j
            if surplus_j > 0.0 and self.passive:
                port.give_back(surplus_j * dt_s / (dt_s + self.model.return_s))
        if feedback is None or feedback[7]:
            keep = max(0.0, 1.0 - dt_s / self.model.relax_s)
            self._goal_x *= keep
            self._goal_y *= keep
        else:
            self._goal_x, self._goal_y = scale * feedback[0], scale * feedback[1]

        share = dt_s / (dt_s + velocity_s)
        self._vx = vx = self._vx + (dx / dt_s - self._vx) * share
        self._vy = vy = self._vy + (dy / dt_s - self._vy) * share
        gx, gy = self._gx, self._gy
        change_x, change_y = self._goal_x - gx, self._goal_y - gy
        change = sqrt(change_x * change_x + change_y * change_y)
        most = rate * dt_s
        if self._regaining:
            slow = self.model.regain_n_s * dt_s
            self._regaining = change > slow
            gx, gy = self._regained(gx, gy, most, slow)
        else:
            if change > most:
                change_x *= most / change
                change_y *= most / change
            gx += change_x
            gy += change_y
        bx, by = -damping * vx, -damping * vy
        fx, fy = gx + bx, gy + by
        force = sqrt(fx * fx + fy * fy)
        if force > self.limit_n:
            share = self.limit_n / force
            gx, gy, bx, by = gx * share, gy * share, bx * share, by * share

        if self.passive:
            # The way of the next cycle, if the handle goes on as it went.
            ahead = _CYCLE_S / dt_s
            dx *= ahead
            dy *= ahead
            left_j = port.credit_j + _ROUNDING_J
            need_j = bx * dx + by * dy + sqrt(bx * bx + by * by) * margin
            if need_j > 0.0:
                if need_j > left_j:
                    share = left_j / need_j if left_j > 0.0 else 0.0
                    bx, by, need_j = bx * share, by * share, need_j * share
                left_j -= need_j
            force = sqrt(gx * gx + gy * gy)
            flow_j = gx * dx + gy * dy
            reserved_j = (1.0 - self.model.reserved) * min(left_j, self.model.reserve_j)
            if (
                flow_j + force * margin > left_j
                or flow_j * self.model.horizon > left_j - reserved_j
            ) and force > 0.0:
                gx, gy = self._cut(gx, gy, dx, dy, left_j, left_j - reserved_j)
                self.acted += 1
                self._regaining = True
        self._gx, self._gy = gx, gy
        self._fx, self._fy = gx + bx, gy + by
        return self._fx, self._fy

    def _regained(self, gx: float, gy: float, most: float, slow: float) -> tuple[float, float]:
        """(gx, gy) on its way back to the goal: along that by at most `slow`, and what it has
        across it or beyond it less by at most `most`.

        Without the second a cut would turn the force instead of taking from it: the rest, across
        the motion, would stay while the goal changes, and grow into the wall in the end.
        """
        goal_x, goal_y = self._goal_x, self._goal_y
        size = goal_x * goal_x + goal_y * goal_y
        share = (gx * goal_x + gy * goal_y) / size if size > 0.0 else 0.0
        share = 0.0 if share < 0.0 else 1.0 if share > 1.0 else share
        near_x, near_y = share * goal_x, share * goal_y
        off_x, off_y = near_x - gx, near_y - gy
        off = sqrt(off_x * off_x + off_y * off_y)
        less = most / off if off > most else 1.0
        lacking = (1.0 - share) * sqrt(size)
        more = slow / lacking if lacking > slow else 1.0
        return (
            gx + off_x * less + (goal_x - near_x) * more,
            gy + off_y * less + (goal_y - near_y) * more,
        )

    def _cut(
        self, gx: float, gy: float, dx: float, dy: float, left_j: float, spend_j: float
    ) -> tuple[float, float]:
        """The force scaled down: along (dx, dy) to what `spend_j` pays for over the horizon, and
        as a whole so that no way within the margin of (dx, dy) costs more than `left_j`."""
        margin = self._constants[4]
        flow_j = gx * dx + gy * dy
        if flow_j > 0.0 and flow_j * self.model.horizon > spend_j:
            lacking = 1.0 - max(0.0, spend_j) / (flow_j * self.model.horizon)
            size = dx * dx + dy * dy
            if size > 0.0:
                along = lacking * flow_j / size
                gx -= along * dx
                gy -= along * dy
                flow_j *= 1.0 - lacking
        need_j = flow_j + sqrt(gx * gx + gy * gy) * margin
        if need_j > left_j:
            share = max(0.0, left_j) / need_j if need_j > 0.0 else 0.0
            gx *= share
            gy *= share
        return gx, gy
