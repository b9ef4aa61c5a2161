"""The controller at the robot: it pulls the tip to the hand's position and keeps that passive.

A spring and a damper between a reference and the tip give the force on the tip (impedance control:
N. Hogan, "Impedance Control", J. Dyn. Sys. Meas. Control 107, 1985). The port is the reference: its
energy is the coordinating force times the distance that the reference moves. It is a passivity
controller of the admittance type; docs/haptics.md has the equations.
"""

from dataclasses import dataclass
from math import sqrt

from kontur_av.clock import NS_PER_S
from telepresence.haptics.passivity import Port, PortController
from telepresence.haptics.sample import STATE_APPLICATION, Command

#: A step that dissipates less counts as no step.
_NO_COST_J = 1e-18
#: A tip that catches up would overshoot the reference's greatest speed. From so far below that
#: speed on, the force along the tip's motion falls from so much to nothing, and beyond it brakes.
#: With a lower greatest speed it falls within less, but with no slope that 0.5 kg cannot follow.
_SLOWING_N, _SLOWING_M_S, _LEAST_SLOWING_M_S = 25.0, 0.1, 0.0625
#: A hand rests while it is this near (m) to its smoothed position, with this time constant (s). A
#: tremor costs the robot's damper more than it gives. So when the hand has rested for so long (s)
#: in contact, a robot that is short of credit follows the smoothed position.
_REST_M, _REST_S, _RESTED_S = 0.002, 0.1, 0.3
#: While the joystick lacks the credit to show a press, the press decays, and its energy pays for
#: what is shown. So the robot does not press harder than the hand feels for long. The lack is
#: smoothed with this time constant (s).
_LACK_S, _LEAST_LACK = 0.2, 0.05
#: Time constants in seconds and in round trips: of the decay while the joystick always lacks, and
#: of the growth once it lacks no more.
_DECAY_S, _DECAY_TRIPS, _GROWTH_S, _GROWTH_TRIPS = 2.0, 16.0, 0.2, 2.0
#: A press that grows faster than its force reaches the hand swings with the hand's late answer. So
#: its time constant is so many times the part of the round trip beyond this (s).
_PRESS_TRIPS, _SHORT_S = 2.0, 0.03


@dataclass(frozen=True, kw_only=True, slots=True)
class RobotControllerModel:
    """Parameters of the controller at the robot; all of them chosen.

    stiffness_n_m, damping_n_s_m: between reference and tip; critically damped for 0.5 kg.
    force_limit_n: of the coordinating force, per axis.
    follow_s: time constant with which the reference follows the received position. It smooths the
    steps of 20 µm and the jitter of the path.
    speed_m_s, acceleration_m_s2: limits of the reference, also while it catches up.
    relax_s: without commands the reference moves to the tip with this time constant, so that the
    tip's pressure decays. let_go_s: as much while the caller wants it; a soft wall pushes the tip
    back (1 + stiffness / wall) times as slowly.
    timeout_s: before this it stands still; bursts of losses are shorter.
    half_width_m, half_height_m: the reference stays within the board.
    reserve_j, limit_j: see `Port`. The reserve is about the energy of the moving tip; the energy
    recovered by braking pays for the next movement. The limit lets an approach through a long delay
    pay for a press.
    spare_j, return_s: while the joystick lacks credit, credit above `spare_j` returns to it with
    this time constant.
    discard_s: in contact, credit above `spare_j` is discarded with this time constant.
    spend_s: while the hand rests, a free tip that catches up spends at most its credit in this
    time. Friction costs power with the square of the speed, so a slower tip goes further.
    """

    stiffness_n_m: float = 1000.0
    damping_n_s_m: float = 45.0
    force_limit_n: float = 30.0
    follow_s: float = 0.008
    speed_m_s: float = 0.5
    acceleration_m_s2: float = 50.0
    relax_s: float = 0.2
    let_go_s: float = 0.02
    timeout_s: float = 0.08
    half_width_m: float = 0.15
    half_height_m: float = 0.10
    reserve_j: float = 0.020
    limit_j: float = 0.3
    spare_j: float = 0.005
    return_s: float = 0.1
    discard_s: float = 0.4
    spend_s: float = 0.5


class RobotController(PortController):
    """Call `step` once a millisecond; it returns the force on the tip until the next step.

    passive: if False, the controller only observes.
    reference_x_m, reference_y_m: the position that the tip is pulled to.
    holding: the reference follows no command.
    speed_m_s: limit of the reference's speed; the caller may lower it.
    letting_go: the press decays, whatever the command; for the caller to set.
    trip_s: the measured round trip, by `set_trip`; None: the hand feels a rendered wall.
    press_s: time constant with which a press grows, besides that of the reference; by `set_trip`.
    acted: number of steps that cost more than the credit.
    """

    def __init__(
        self,
        model: RobotControllerModel | None = None,
        *,
        passive: bool = True,
        x_m: float = 0.0,
        y_m: float = 0.0,
    ) -> None:
        self.model = model = model or RobotControllerModel()
        self.passive = passive
        self.port = (
            Port(reserve_j=model.reserve_j, limit_j=model.limit_j) if passive else Port.observing()
        )
        self.acted = 0
        self.speed_m_s = model.speed_m_s
        self.holding = True
        self.letting_go = False
        self.trip_s: float | None = None
        self.press_s = 0.0
        self.reference_x_m, self.reference_y_m = x_m, y_m
        self._vx = self._vy = 0.0
        #: Follows the received position with the time constant `_REST_S`.
        self._slow_x, self._slow_y = x_m, y_m
        self._silent_s = 0.0
        #: By the newest command, if there is one, the hand rests; and for how long.
        self._rests = False
        self._rested_s = 0.0
        #: From 0 to 1: how often the joystick has lacked the credit to show a press of late.
        self._unfelt = 0.0

    def set_trip(self, trip_s: float, *, told: bool, tells: bool) -> None:
        """Take the measured round trip, before a step.

        told: the hand feels a rendered wall. tells: it will feel one, which is found by pressing.
        """
        self.trip_s = trip_s if self.passive and not told else None
        direct = self.passive and not tells and trip_s > _SHORT_S
        self.press_s = _PRESS_TRIPS * (trip_s - _SHORT_S) if direct else 0.0

    def release(self, x_m: float, y_m: float) -> None:
        """Another mode drives the robot: move the reference to the tip, and lose the energy."""
        self.reference_x_m, self.reference_y_m = x_m, y_m
        self._vx = self._vy = 0.0
        self.holding = True

    def step(
        self,
        command: Command | None,
        x_m: float,
        y_m: float,
        vx_m_s: float,
        vy_m_s: float,
        dt_ns: int,
        *,
        touching: bool = False,
    ) -> tuple[float, float]:
        """Return the force on the tip (N, N) from now on, `dt_ns` after the previous step.

        command: the newest sample, or None if no sample is fresh. A command moves nothing unless
        its dead-man button is pressed and its joystick is in the application.
        x_m, y_m, vx_m_s, vy_m_s: position and velocity of the tip.
        touching: the tip touches something.
        """
        port, model, dt_s = self.port, self.model, dt_ns / NS_PER_S
        if command is None:
            port.handle_silence(dt_ns)
            self._silent_s += dt_s
        else:
            port.handle_total(command[2], dt_ns)
            self._silent_s = 0.0
        vx, vy = self._wanted(command, x_m, y_m, dt_s, touching)
        most = port.credit_j
        if self._rests and not touching:
            most *= dt_s / (dt_s + model.spend_s)
        # The force is linear in the step d of the reference: f = still + gain * d.
        dx, dy = vx * dt_s, vy * dt_s
        gain = model.stiffness_n_m + model.damping_n_s_m / dt_s
        reference_x, reference_y = self.reference_x_m, self.reference_y_m
        still_x = model.stiffness_n_m * (reference_x - x_m) - model.damping_n_s_m * vx_m_s
        still_y = model.stiffness_n_m * (reference_y - y_m) - model.damping_n_s_m * vy_m_s
        fx, fy = still_x + gain * dx, still_y + gain * dy
        cost = fx * dx + fy * dy
        if self.passive and cost > most and cost > 0.0:
            # A tip that only goes slower lacks nothing.
            self.acted += cost > port.credit_j
            dx, dy = self._cut(still_x, still_y, dx, dy, gain, most)
            fx, fy = still_x + gain * dx, still_y + gain * dy
            vx, vy = dx / dt_s, dy / dt_s
        limit = model.force_limit_n
        if not (-limit <= fx <= limit and -limit <= fy <= limit):
            fx, fy = _within(fx, limit), _within(fy, limit)
            if self.passive and fx * dx + fy * dy > port.credit_j:
                # The reference stays, so use the force of a resting reference.
                dx = dy = vx = vy = 0.0
                fx, fy = _within(still_x, limit), _within(still_y, limit)
        port.handle_flow(fx * dx + fy * dy)
        self._vx, self._vy = vx, vy
        self.reference_x_m, self.reference_y_m = reference_x + dx, reference_y + dy
        surplus_j = port.credit_j - model.spare_j
        if surplus_j > 0.0 and self.passive:
            if command is not None and command[6]:
                port.return_credit(surplus_j * dt_s / (dt_s + model.return_s))
            if touching:
                port.discard_credit(surplus_j * dt_s / (dt_s + model.discard_s))
        return self._slowed(fx, fy, vx_m_s, vy_m_s)

    def _wanted(
        self, command: Command | None, x_m: float, y_m: float, dt_s: float, touching: bool
    ) -> tuple[float, float]:
        """Return the velocity (m/s) that the reference is to have, within its limits."""
        model, reference_x, reference_y = self.model, self.reference_x_m, self.reference_y_m
        self._rests = False
        if command is None and self._silent_s <= model.timeout_s and not self.letting_go:
            self.holding = True
            vx = vy = 0.0
        elif (
            command is None
            or self.letting_go
            or not command[3]
            or command[4] != STATE_APPLICATION
            or command[7]
        ):
            self.holding = True
            share = 1.0 / (model.let_go_s if self.letting_go else model.relax_s)
            vx, vy = (x_m - reference_x) * share, (y_m - reference_y) * share
        else:
            self.holding = False
            to_x, to_y = command[0], command[1]
            width, height = model.half_width_m, model.half_height_m
            to_x = width if to_x > width else -width if to_x < -width else to_x
            to_y = height if to_y > height else -height if to_y < -height else to_y
            moved_x, moved_y = to_x - self._slow_x, to_y - self._slow_y
            share = dt_s / (dt_s + _REST_S)
            self._slow_x += moved_x * share
            self._slow_y += moved_y * share
            self._rests = moved_x * moved_x + moved_y * moved_y < _REST_M * _REST_M
            self._rested_s = self._rested_s + dt_s if self._rests else 0.0
            if self._rested_s > _RESTED_S and touching and self.passive:
                poor = min(1.0, max(0.0, 1.0 - self.port.credit_j / model.spare_j))
                to_x += (self._slow_x - to_x) * poor
                to_y += (self._slow_y - to_y) * poor
            share = 1.0 / (model.follow_s + dt_s)
            vx, vy = (to_x - reference_x) * share, (to_y - reference_y) * share
            if touching:
                press_x, press_y = reference_x - x_m, reference_y - y_m
                vx, vy = self._shown(command[6], vx, vy, press_x, press_y, dt_s)
            else:
                # A free tip catches up as before.
                self._unfelt = 0.0
        size, speed = vx * vx + vy * vy, self.speed_m_s
        if size > speed * speed:
            share = speed / sqrt(size)
            vx *= share
            vy *= share
        change_x, change_y = vx - self._vx, vy - self._vy
        size, most = change_x * change_x + change_y * change_y, model.acceleration_m_s2 * dt_s
        if size > most * most:
            share = most / sqrt(size)
            return self._vx + change_x * share, self._vy + change_y * share
        return vx, vy

    def _shown(
        self, lacks: bool, vx: float, vy: float, press_x: float, press_y: float, dt_s: float
    ) -> tuple[float, float]:
        """Return the velocity (m/s) with which a press grows slowly; one that is not felt decays.

        lacks: the joystick lacks the credit to show it.
        press_x, press_y: the spring's stretch (m).
        """
        self._unfelt = unfelt = self._unfelt + (lacks - self._unfelt) * dt_s / (dt_s + _LACK_S)
        press_2 = press_x * press_x + press_y * press_y
        if press_2 == 0.0:
            return vx, vy
        wanted = growth = (vx * press_x + vy * press_y) / press_2
        if growth > 0.0 and self.press_s > 0.0:
            growth *= self.model.follow_s / (self.model.follow_s + self.press_s)
        trip_s = self.trip_s
        if trip_s is not None and unfelt >= _LEAST_LACK:
            most = 1.0 - 2.0 * unfelt
            if most < 0.0:
                most /= _DECAY_S + _DECAY_TRIPS * trip_s
            else:
                most /= _GROWTH_S + _GROWTH_TRIPS * trip_s
            growth = min(growth, most)
        surplus = wanted - growth
        return vx - surplus * press_x, vy - surplus * press_y

    def _slowed(self, fx: float, fy: float, vx_m_s: float, vy_m_s: float) -> tuple[float, float]:
        """Return the force on a tip of this velocity: it brakes a tip that goes too fast.

        The rest of the spring's force is lost as in a brake; the port pays for it.
        """
        speed, tip_m_s = self.speed_m_s, sqrt(vx_m_s * vx_m_s + vy_m_s * vy_m_s)
        slowing_m_s = _SLOWING_M_S if speed > _SLOWING_M_S else speed
        if tip_m_s > speed - slowing_m_s:
            along = (fx * vx_m_s + fy * vy_m_s) / tip_m_s
            slope = _SLOWING_N / max(slowing_m_s, _LEAST_SLOWING_M_S)
            over = along - slope * (speed - tip_m_s)
            if over > 0.0:
                return fx - over * vx_m_s / tip_m_s, fy - over * vy_m_s / tip_m_s
        return fx, fy

    def _cut(
        self, still_x: float, still_y: float, dx: float, dy: float, gain: float, most: float
    ) -> tuple[float, float]:
        """Scale the step of the reference along the force so that it costs exactly `most` (J).

        The part of the step across the force is orthogonal to it and costs nothing. With a share s
        of the part along the force, the step costs s*b + s^2*a.
        """
        credit = max(0.0, most)
        fx, fy = still_x + gain * dx, still_y + gain * dy
        force = sqrt(fx * fx + fy * fy)
        along_x, along_y = fx / force, fy / force
        along = dx * along_x + dy * along_y
        a = gain * along * along
        if a < _NO_COST_J:
            return 0.0, 0.0
        b = along * (still_x * along_x + still_y * along_y)
        # Slightly less than the root, so that rounding cannot cost more than that.
        share = (sqrt(b * b + 4.0 * a * credit) - b) / (2.0 * a) * (1.0 - 1e-9)
        share = min(1.0, max(0.0, share))
        lacking = (1.0 - share) * along
        return dx - lacking * along_x, dy - lacking * along_y


def _within(force_n: float, limit_n: float) -> float:
    return limit_n if force_n > limit_n else -limit_n if force_n < -limit_n else force_n
