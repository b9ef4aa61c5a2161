"""The controller at the joystick: it displays the robot's force and keeps the display passive.

The port is the handle. Its energy in one cycle is the force that the motors hold, times the
distance that the handle moves. Both are known exactly one cycle later, so the observer is exact in
sampled time. docs/haptics.md has the equations.

The credit bounds the force as the energy of a spring bounds its force, so nothing is switched, and
nothing can chatter (J.-P. Kim and J. Ryu, "Robustly stable haptic interaction control using an
energy-bounding algorithm", Int. J. Robotics Research 29, 2010; a margin of the credit for the whole
fade is this project's own).

The damping is the energy's source (M. Franken et al., "Bilateral telemanipulation with time delays:
a two-layer approach combining passivity and transparency", IEEE Trans. Robotics 27, 2011). The
robot's force and the damping are bounded one after the other: else a hand that leaves a wall would
lose its damping to pay for the force that still pushes it.
"""

from dataclasses import dataclass
from math import hypot, inf, sqrt

from kontur_av.clock import NS_PER_MS, NS_PER_S
from telepresence.haptics.passivity import Port, PortController
from telepresence.haptics.sample import Feedback

_CYCLE_S = NS_PER_MS / NS_PER_S
#: Half a count of the energy in a sample, too little for anybody to measure. Without it a hand that
#: starts slowly would feel no damping, grant no energy, and never start to move the robot.
_ROUNDING_J = 0.5e-6
#: How fast a lack of the robot counts.
_STARVED_S = 0.1
#: A force this near to the wanted one has returned.
_RETURNED_N = 0.05
#: The robot presses at most `press_ratio` times as hard as the hand feels, and this much more.
PRESS_RATIO, PRESS_N = 1.25, 2.0


@dataclass(frozen=True, kw_only=True, slots=True)
class JoystickControllerModel:
    """Parameters of the controller at the joystick; all of them chosen.

    force_scale: displayed force over the robot's force.
    damping_n_s_m, most_damping_n_s_m: damping that the hand feels while the credit is whole, and
    while it lacks. The energy that it takes out of the hand moves the robot and pays for its force.
    press_damping_n_s_m, leave_damping_n_s_m: as the latter, while the hand moves against the force
    of a contact, and with it. What a delay costs is a damping of the wall's stiffness times the
    round trip.
    damping_s: time constant with which the damping follows the credit. It is short, since a hand
    that has hit a wall swings, and so gives energy, for 0.1 to 0.2 s only.
    starved_s: the damping stays this long after the robot's credit has lacked.
    rate_n_s, damping_rate_n_s: fastest change of the displayed force and of the damping force.
    relax_s: time constant with which the force decays without samples.
    timeout_s: it does not decay before this; bursts of losses are shorter.
    acceleration_m_s2: greatest acceleration of the handle; it bounds the next cycle's distance.
    fade_n_m: stiffness with which a force fades when its credit is used up.
    regain_n_s: how fast the force returns after a fade.
    velocity_s: time constant of the velocity that damping and fade use.
    reserve_j, limit_j: see `Port`. Credit above the reserve returns to the robot with the time
    constant `return_s`; so does all that the present force does not need, when the robot lacks it.
    """

    force_scale: float = 1.0
    damping_n_s_m: float = 4.0
    most_damping_n_s_m: float = 20.0
    press_damping_n_s_m: float = 100.0
    leave_damping_n_s_m: float = 60.0
    damping_s: float = 0.02
    starved_s: float = 1.0
    rate_n_s: float = 800.0
    damping_rate_n_s: float = 250.0
    relax_s: float = 0.1
    timeout_s: float = 0.08
    acceleration_m_s2: float = 150.0
    fade_n_m: float = 2000.0
    regain_n_s: float = 30.0
    velocity_s: float = 0.003
    reserve_j: float = 0.03
    limit_j: float = 0.5
    return_s: float = 0.1


class JoystickController(PortController):
    """Call `step` once a millisecond; it returns the force on the handle until the next step.

    passive: if False, the controller only observes.
    limit_n: the force (N) that the motors can exert now; set it before a step.
    rate_n_s, most_rate_n_s: fastest change of the robot's force, and of all; a caller may lower it.
    acted: number of cycles in which the credit bounded the force.
    damping_n_s_m: the present damping.
    spared_j: kept for the damping, whose force turns later than the hand, when the robot lacks all.
    most_j: the robot's force may give out no more than this, whatever the credit; set it before a
    step.
    held_back_m: the place that the robot is told, less that of the handle (m, m).
    press_ratio: how many times as hard as the hand feels the robot may press; the caller sets it.
    presses_n, gives_n: how hard the robot presses, as far as is known here, and the motors' answer.
    beyond_n: how much more the robot has pressed at most.
    """

    held_back_m = (0.0, 0.0)
    press_ratio = PRESS_RATIO
    presses_n = gives_n = beyond_n = 0.0
    spared_j = 0.0
    most_j = inf

    def __init__(
        self, model: JoystickControllerModel | None = None, *, passive: bool = True
    ) -> None:
        self.model = model = model or JoystickControllerModel()
        self.passive = passive
        self.port = (
            Port(reserve_j=model.reserve_j, limit_j=model.limit_j) if passive else Port.observing()
        )
        self.limit_n = 12.0
        self.rate_n_s = model.rate_n_s
        self.most_rate_n_s = model.rate_n_s + model.damping_rate_n_s
        self.acted = 0
        self.damping_n_s_m = model.damping_n_s_m
        self._last: tuple[float, float] | None = None
        self._goal_x = self._goal_y = 0.0
        self._fx = self._fy = 0.0
        #: The robot's share of the force, and the damping's.
        self._gx = self._gy = 0.0
        self._bx = self._by = 0.0
        self._regaining = False
        self._vx = self._vy = 0.0
        self._silent_s = 0.0
        #: The robot's newest sample; None without contact.
        self._out: Feedback | None = None
        #: From 0 to 1: how much the robot has lacked credit of late.
        self._starved = 0.0
        self._margin_m = model.acceleration_m_s2 * _CYCLE_S * _CYCLE_S

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
        dt_s, model, last = dt_ns / NS_PER_S, self.model, self._last
        self._last = (x_m, y_m)
        if last is None:
            # The velocity is not known yet, so neither is the energy that a force would cost.
            return 0.0, 0.0
        dx, dy = x_m - last[0], y_m - last[1]
        self._book(self._fx * dx + self._fy * dy)
        self._hear(feedback, dt_ns)
        share = dt_s / (dt_s + model.velocity_s)
        self._vx = vx = self._vx + (dx / dt_s - self._vx) * share
        self._vy = vy = self._vy + (dy / dt_s - self._vy) * share
        if self.passive:
            self._follow_credit(feedback, dt_s)
        gx, gy, change = self._approached(vx, vy, dt_s)
        most, left = model.damping_rate_n_s * dt_s, self.most_rate_n_s * dt_s - change
        most = left if left < most else most
        bx, by = self._damped(vx, vy, most)
        fx, fy = gx + bx, gy + by
        force = sqrt(fx * fx + fy * fy)
        if force > self.limit_n:
            share = self.limit_n / force
            gx, gy, bx, by = gx * share, gy * share, bx * share, by * share
        if self.passive:
            # The distance of the next cycle at the present velocity.
            ahead = _CYCLE_S / dt_s
            gx, gy, bx, by = self._payable(gx, gy, bx, by, dx * ahead, dy * ahead)
            if feedback is not None:
                self._return_surplus(feedback, dt_s)
        self._gx, self._gy, self._bx, self._by = gx, gy, bx, by
        self._fx, self._fy = gx + bx, gy + by
        if feedback is not None:
            self._note_press(feedback)
        return self._fx, self._fy

    def _note_press(self, feedback: Feedback) -> None:
        """Note how hard the robot presses, and whence."""
        self._out = feedback if feedback[3] else None
        self._compare(hypot(feedback[0], feedback[1]), hypot(self._gx, self._gy))

    def most_press_n(self, gives_n: float) -> float:
        """Return how hard the robot may press (N) while the motors give the hand `gives_n`."""
        return PRESS_N + self.press_ratio * gives_n

    def _compare(self, presses_n: float, gives_n: float) -> None:
        self.presses_n, self.gives_n = presses_n, gives_n
        if presses_n - gives_n > self.beyond_n:
            self.beyond_n = presses_n - gives_n

    def _hear(self, feedback: Feedback | None, dt_ns: int) -> None:
        """Take the robot's grant and its force; without samples the force decays."""
        if feedback is None:
            self.port.handle_silence(dt_ns)
            self._silent_s += dt_ns / NS_PER_S
        else:
            self.port.handle_total(feedback[2], dt_ns)
            self._silent_s = 0.0
        if self._silent_s > self.model.timeout_s or (feedback is not None and feedback[7]):
            keep = max(0.0, 1.0 - dt_ns / NS_PER_S / self.model.relax_s)
            self._goal_x *= keep
            self._goal_y *= keep
        elif feedback is not None:
            scale = self.model.force_scale
            self._goal_x, self._goal_y = scale * feedback[0], scale * feedback[1]

    def _approached(self, vx: float, vy: float, dt_s: float) -> tuple[float, float, float]:
        """Return the robot's force (N, N), nearer to what the credit can fade; and its change."""
        rate, gx, gy = self.rate_n_s, self._gx, self._gy
        goal_x, goal_y = self._goal_x, self._goal_y
        if self.passive and (goal_x or goal_y):
            goal, now = sqrt(goal_x * goal_x + goal_y * goal_y), sqrt(gx * gx + gy * gy)
            outward = (gx * vx + gy * vy) / now if now > 0.0 else 0.0
            credit_j, most_j = self.port.credit_j, self.most_j
            credit_j = most_j if most_j < credit_j else credit_j
            most = self._payable_n(credit_j + _ROUNDING_J, outward if outward > 0.0 else 0.0)
            if most < goal:
                share, goal = most / goal, most
                goal_x *= share
                goal_y *= share
                self.acted += 1
                self._regaining = True
            if self._regaining and goal > now:
                rate = min(rate, self.model.regain_n_s)
        change_x, change_y = goal_x - gx, goal_y - gy
        change = sqrt(change_x * change_x + change_y * change_y)
        if change > rate * dt_s:
            share = rate * dt_s / change
            change_x *= share
            change_y *= share
            change = rate * dt_s
        gx += change_x
        gy += change_y
        if self._regaining:
            lacking_x, lacking_y = self._goal_x - gx, self._goal_y - gy
            if lacking_x * lacking_x + lacking_y * lacking_y < _RETURNED_N * _RETURNED_N:
                self._regaining = False
        return gx, gy, change

    def _payable(
        self, gx: float, gy: float, bx: float, by: float, dx: float, dy: float
    ) -> tuple[float, float, float, float]:
        """Cut the robot's force, and before it the damping, to what the next cycle can pay for.

        dx, dy: the distance of the next cycle; the handle may accelerate beyond it.
        """
        left_j, margin = self.port.credit_j + _ROUNDING_J, self._margin_m
        need_j = bx * dx + by * dy + sqrt(bx * bx + by * by) * margin
        if need_j > 0.0:
            if need_j > left_j:
                share = left_j / need_j if left_j > 0.0 else 0.0
                bx, by, need_j = bx * share, by * share, need_j * share
            left_j -= need_j
        left_j = self.most_j if self.most_j < left_j else left_j
        need_j = gx * dx + gy * dy + sqrt(gx * gx + gy * gy) * margin
        if need_j > left_j:
            share = left_j / need_j if left_j > 0.0 else 0.0
            gx, gy = gx * share, gy * share
            self.acted += 1
            self._regaining = True
        return gx, gy, bx, by

    def _book(self, energy_j: float) -> None:
        """Count the energy that this controller's force gave to the hand, or took if negative."""
        self.port.handle_flow(energy_j)

    def _payable_n(self, credit_j: float, outward_m_s: float) -> float:
        """Return the largest force (N) that can fade on this credit at this outward speed.

        The next cycle comes first: its force is held, and the handle may accelerate.
        """
        if credit_j <= 0.0:
            return 0.0
        cycle_m, yielding = self._fading(outward_m_s)
        # The root of force * cycle_m + force^2 * yielding / 2 = credit.
        return (sqrt(cycle_m * cycle_m + 2.0 * yielding * credit_j) - cycle_m) / yielding

    def _fade_j(self) -> float:
        """Return the credit with which the robot's force can fade, as in `_payable_n`."""
        force = sqrt(self._gx * self._gx + self._gy * self._gy)
        if force == 0.0:
            return 0.0
        outward_m_s = max(0.0, (self._gx * self._vx + self._gy * self._vy) / force)
        cycle_m, yielding = self._fading(outward_m_s)
        return force * cycle_m + force * force * yielding / 2.0

    def _fading(self, outward_m_s: float) -> tuple[float, float]:
        """Return the next cycle's distance (m), and the way of a fade for each newton (m/N)."""
        cycle_m = outward_m_s * _CYCLE_S + self._margin_m
        return cycle_m, 1.0 / self.model.fade_n_m + outward_m_s / self.model.rate_n_s

    def _follow_credit(self, feedback: Feedback | None, dt_s: float) -> None:
        """Let the damping follow what either end lacks; without samples it returns to normal."""
        model = self.model
        lack = 0.0
        if feedback is not None:
            starved = 1.0 if feedback[6] else 0.0
            after_s = _STARVED_S if starved else model.starved_s
            self._starved += (starved - self._starved) * dt_s / (dt_s + after_s)
            lack, starved = 1.0 - self.port.credit_j / model.reserve_j, self._starved
            lack = starved if starved > lack else 1.0 if lack > 1.0 else lack
        wanted = model.damping_n_s_m + (model.most_damping_n_s_m - model.damping_n_s_m) * lack
        self.damping_n_s_m += (wanted - self.damping_n_s_m) * dt_s / (dt_s + model.damping_s)

    def _damped(self, vx: float, vy: float, most: float) -> tuple[float, float]:
        """Return the damping force (N, N), which changes by `most` (N) at most."""
        model, damping, bx, by = self.model, self.damping_n_s_m, self._bx, self._by
        least, out = model.damping_n_s_m, self._out
        if out is not None and damping > least:
            presses = out[0] * vx + out[1] * vy < 0.0
            lack = (damping - least) / (model.most_damping_n_s_m - least)
            most_n_s_m = model.press_damping_n_s_m if presses else model.leave_damping_n_s_m
            damping = least + lack * (most_n_s_m - least)
        change_x, change_y = -damping * vx - bx, -damping * vy - by
        change = sqrt(change_x * change_x + change_y * change_y)
        share = most / change if change > most else 1.0
        return bx + change_x * share, by + change_y * share

    def _return_surplus(self, feedback: Feedback, dt_s: float) -> None:
        """Return credit beyond the reserve; if the robot lacks it, all that no force needs."""
        model, port = self.model, self.port
        keep_j = model.reserve_j
        if feedback[6]:
            goal_2 = self._goal_x * self._goal_x + self._goal_y * self._goal_y
            keep_j = min(keep_j, self.spared_j + goal_2 / (2.0 * model.fade_n_m))
        surplus_j = port.credit_j - keep_j
        if surplus_j > 0.0:
            port.return_credit(surplus_j * dt_s / (dt_s + model.return_s))
