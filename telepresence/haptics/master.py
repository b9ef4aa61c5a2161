"""The controller at the joystick: it displays the robot's force and keeps that passive.

The port is the handle: the force that the motors hold for a cycle, and the way that the handle
goes in it. Both are known exactly one cycle later, so the observer is true in sampled time. What
the next cycle may give out is bounded beforehand: the handle goes on as it went, give or take what
its greatest acceleration makes of that in one cycle. If that could be more than the credit, the
part of the force along the motion is scaled down (a passivity controller of the impedance type).
Nothing is ever added or turned round, so there is no gain that could grow at low speed.
"""

from dataclasses import dataclass
from math import sqrt

from kontur_av.clock import NS_PER_MS, NS_PER_S
from telepresence.haptics.passivity import Port, PortFigures
from telepresence.haptics.sample import Feedback

_CYCLE_S = NS_PER_MS / NS_PER_S
#: In a cycle. Less has no direction.
_NO_WAY_M = 1e-9


@dataclass(frozen=True, kw_only=True, slots=True)
class MasterModel:
    """Parameters of the controller at the joystick; all of them chosen.

    force_scale: displayed force over the robot's. damping_n_s_m: what the hand always feels; the
    energy that it takes out of the hand is what moves the robot while nothing is touched.
    rate_n_s: the displayed force grows no faster: no blow on resumption. relax_s: without samples
    it decays with this time constant. acceleration_m_s2: the handle never has more: it bounds how
    far the next cycle can differ from the last. horizon: the credit must last for so many cycles
    at the present speed, so that a force that can't be paid for fades instead of breaking off.
    velocity_s: time constant of the velocity that the damping uses. reserve_j, limit_j: `Port`.
    """

    force_scale: float = 1.0
    damping_n_s_m: float = 4.0
    rate_n_s: float = 1000.0
    relax_s: float = 0.1
    acceleration_m_s2: float = 150.0
    horizon: float = 5.0
    velocity_s: float = 0.003
    reserve_j: float = 0.004
    limit_j: float = 0.5


class MasterController(PortFigures):
    """`step` once a millisecond gives the force on the handle; it is held until the next step.

    passive: without, the same controller only observes. limit_n: of the force, by what the motors
    can give now; set it before a step. acted: cycles in which the passivity controller cut.
    """

    def __init__(self, model: MasterModel | None = None, *, passive: bool = True) -> None:
        self.model = model = model or MasterModel()
        self.passive = passive
        self.port = (
            Port(reserve_j=model.reserve_j, limit_j=model.limit_j) if passive else Port.observing()
        )
        self.limit_n = 12.0
        self.acted = 0
        self._last: tuple[float, float] | None = None
        self._goal_x = self._goal_y = 0.0
        self._fx = self._fy = 0.0
        self._vx = self._vy = 0.0
        # Looked up at once, not one by one: `step` is called a thousand times a second.
        self._constants = (
            model.force_scale,
            model.damping_n_s_m,
            model.rate_n_s,
            model.velocity_s,
            model.acceleration_m_s2 * _CYCLE_S * _CYCLE_S,
        )

    def handle_restart(self) -> None:
        """The peer began anew."""
        self.port.handle_restart()

    def step(
        self, feedback: Feedback | None, x_m: float, y_m: float, dt_ns: int
    ) -> tuple[float, float]:
        """The force on the handle (N, N) from now on, `dt_ns` after the step before.

        feedback: the newest sample, None if there is no fresh one. x_m, y_m: where the handle is.
        """
        scale, damping, rate, velocity_s, margin = self._constants
        dt_s = dt_ns / NS_PER_S
        port, last = self.port, self._last
        self._last = (x_m, y_m)
        dx = dy = 0.0
        fx, fy = self._fx, self._fy
        if last is not None:
            dx, dy = x_m - last[0], y_m - last[1]
            port.handle_flow(fx * dx + fy * dy)
        if feedback is None:
            port.handle_silence(dt_ns)
        else:
            port.handle_total(feedback[2], dt_ns)
        if feedback is None or feedback[7]:
            keep = max(0.0, 1.0 - dt_s / self.model.relax_s)
            self._goal_x *= keep
            self._goal_y *= keep
        else:
            self._goal_x, self._goal_y = scale * feedback[0], scale * feedback[1]

        share = dt_s / (dt_s + velocity_s)
        self._vx = vx = self._vx + (dx / dt_s - self._vx) * share
        self._vy = vy = self._vy + (dy / dt_s - self._vy) * share
        change_x = self._goal_x - damping * vx - fx
        change_y = self._goal_y - damping * vy - fy
        change, most = sqrt(change_x * change_x + change_y * change_y), rate * dt_s
        if change > most:
            change_x *= most / change
            change_y *= most / change
        fx += change_x
        fy += change_y
        force = sqrt(fx * fx + fy * fy)
        if force > self.limit_n:
            fx *= self.limit_n / force
            fy *= self.limit_n / force
            force = self.limit_n

        if self.passive:
            # The way of the next cycle, if the handle goes on as it went.
            ahead = _CYCLE_S / dt_s
            dx *= ahead
            dy *= ahead
            flow = fx * dx + fy * dy
            need = (flow * self.model.horizon if flow > 0.0 else flow) + force * margin
            if need > port.credit_j and need > 0.0:
                self.acted += 1
                fx, fy = self._cut(fx, fy, dx, dy, margin)
        self._fx, self._fy = fx, fy
        return fx, fy

    def _cut(
        self, fx: float, fy: float, dx: float, dy: float, margin: float
    ) -> tuple[float, float]:
        """The force scaled down so that a way within `margin` of (dx, dy) costs the credit."""
        credit = max(0.0, self.port.credit_j)
        flow = fx * dx + fy * dy
        way = sqrt(dx * dx + dy * dy)
        if flow <= 0.0 or way < _NO_WAY_M:
            # It brakes or holds: only what the handle may do in another way costs anything.
            share = credit / (flow + sqrt(fx * fx + fy * fy) * margin)
            return fx * share, fy * share
        along = flow / way
        along_x, along_y = along * dx / way, along * dy / way
        across_x, across_y = fx - along_x, fy - along_y
        aside = sqrt(across_x * across_x + across_y * across_y) * margin
        if aside >= credit:
            share = credit / aside if aside > 0.0 else 0.0
            return across_x * share, across_y * share
        share = min(1.0, (credit - aside) / (along * (way * self.model.horizon + margin)))
        return across_x + along_x * share, across_y + along_y * share
