"""The controller at the joystick: it displays the robot's force and keeps the display passive.

The port is the handle. Its energy in one cycle is the force that the motors hold, times the
distance that the handle moves. Both are known exactly one cycle later, so the observer is exact in
sampled time.

The energy of the next cycle is bounded in advance. The handle moves on at its present velocity,
plus or minus what its greatest acceleration can change in one cycle. If that could cost more than
the credit, the part of the force along the motion is scaled down. This is a passivity controller
of the impedance type. It only scales and adds no damping, so no gain grows at low speed. The force
that was cut returns slowly, and only towards the force that is wanted by then.

The robot's force and the damping are bounded one after the other. If only their sum were bounded, a
hand that leaves a wall would lose its damping to pay for the force that still pushes it. The robot
would then receive no energy with which to follow.
"""

from dataclasses import dataclass
from math import sqrt

from kontur_av.clock import NS_PER_MS, NS_PER_S
from telepresence.haptics.passivity import Port, PortController
from telepresence.haptics.sample import Feedback

_CYCLE_S = NS_PER_MS / NS_PER_S
#: Half a count of the energy in a sample, too little for anybody to measure. Without it a hand that
#: starts slowly would feel no damping, grant no energy, and never start to move the robot.
_ROUNDING_J = 0.5e-6


@dataclass(frozen=True, kw_only=True, slots=True)
class JoystickControllerModel:
    """Parameters of the controller at the joystick; all of them chosen.

    force_scale: displayed force over the robot's force.
    damping_n_s_m: damping that the hand always feels. The energy that it takes out of the hand
    moves the robot in free space.
    rate_n_s: fastest rise of the displayed force, so that it does not jump after an interruption.
    relax_s: time constant with which the force decays without samples.
    acceleration_m_s2: greatest acceleration of the handle; it bounds the next cycle's distance.
    horizon: number of cycles at the present speed for which the credit must last. A force that
    becomes too expensive then fades instead of breaking off.
    reserved: share of the reserve that may pay for the force over a horizon. The damping uses the
    rest.
    regain_n_s: how fast the force returns after a cut; a faster return would buzz.
    velocity_s: time constant of the velocity that the damping uses.
    reserve_j, limit_j: see `Port`.
    keep_j, return_s: credit above `keep_j` returns to the robot with this time constant, because a
    hand at rest has no use for it.
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


class JoystickController(PortController):
    """Call `step` once a millisecond; it returns the force on the handle until the next step.

    passive: if False, the controller only observes.
    limit_n: the force (N) that the motors can exert now; set it before a step.
    acted: number of cycles in which the passivity controller cut the force.
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
        #: The robot's share of the force.
        self._gx = self._gy = 0.0
        self._regaining = False
        self._vx = self._vy = 0.0
        # Unpacked in one step, because `step` is called a thousand times a second.
        self._constants = (
            model.force_scale,
            model.damping_n_s_m,
            model.rate_n_s,
            model.velocity_s,
            model.acceleration_m_s2 * _CYCLE_S * _CYCLE_S,
        )

    @property
    def robot_force_n(self) -> tuple[float, float]:
        """The part of the present force (N, N) that is the robot's; the rest is damping."""
        return self._gx, self._gy

    def step(
        self, feedback: Feedback | None, x_m: float, y_m: float, dt_ns: int
    ) -> tuple[float, float]:
        """Return the force on the handle (N, N) from now on, `dt_ns` after the previous step.

        feedback: the newest sample, or None if no sample is fresh.
        x_m, y_m: position of the handle (m).
        The first step returns no force.
        """
        scale, damping, rate, velocity_s, margin = self._constants
        dt_s = dt_ns / NS_PER_S
        port, last = self.port, self._last
        self._last = (x_m, y_m)
        if last is None:
            # The velocity is not known yet, so neither is the energy that a force would cost.
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
                port.return_credit(surplus_j * dt_s / (dt_s + self.model.return_s))
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
            # The distance of the next cycle at the present velocity.
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
        """Move (gx, gy) back to the goal: along the goal by at most `slow`, else by at most `most`.

        The second limit removes the part across the goal or beyond it. If that part stayed, a cut
        would turn the force instead of reducing it. It would remain across the motion while the
        goal changes, and finally push into the wall.
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
        """Scale the force down so that the credit pays for it.

        Its part along (dx, dy) is cut to what `spend_j` pays for over the horizon. The whole force
        is then cut so that no movement within the margin of (dx, dy) costs more than `left_j`.
        """
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
