"""The joystick's controller for model-mediated haptics: damping as before, force from the model.

The robot's delayed force is not displayed, or only what the model does not explain of it
(`residual`). Two energies are bounded, each alone: the motors never give the hand more than they
took from it (`WallRenderer`), and the robot never gets more than the hand put in. What the hand
puts into the rendered spring is granted to the robot, too, or it could not press. So the network as
a whole is not passive (docs/haptics.md).

`WallRenderer` renders the newest wall at the operator's handle, at 1 kHz and passively. The wall is
a spring in series with the robot's own, so that the hand feels what the robot presses with. It acts
across the plane only. The force of a cycle is held while the handle moves by `d`, so exactly `f·d`
has flowed out. A force that turns does no work.

An energy tank bounds what a change of the wall may add (docs/haptics.md). A part of it
is the spring's own energy f^2 / 2k; only the rest may pay for a wall that appears under the hand,
comes nearer or becomes softer under load.

M. Franken et al., "Bilateral telemanipulation with time delays: a two-layer approach combining
passivity and transparency", IEEE Trans. Robotics 27, 2011, has such tanks. P. Mitra, G. Niemeyer,
"Model-mediated telemanipulation", Int. J. Robotics Research 27, 2008, has the transitions.
"""

from dataclasses import dataclass
from math import hypot, sqrt

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ProtocolError
from telepresence.haptics.joystick_controller import JoystickController, JoystickControllerModel
from telepresence.haptics.mediated.wall import STAMP_MODULUS_MS, Wall, WallMessage, parse_wall
from telepresence.haptics.sample import Feedback

_CYCLE_S = NS_PER_MS / NS_PER_S
#: Up to this speed a spring that relaxes falls slowly enough; a tremor is about as fast.
_SLOW_M_S = 0.02
#: How fast a hand of 0.2 kg, which has pushed by 10 N and lets go, accelerates.
_RELEASED_M_S2 = 50.0


@dataclass(frozen=True, kw_only=True, slots=True)
class RendererModel:
    """Parameters of the rendering; all of them chosen.

    robot_n_m: stiffness between the robot's reference and its tip (`RobotControllerModel`).
    start_j, limit_j: what the tank holds at first and at most. Without a limit, an hour of free
    motion would pay for a minute of instability.
    rise_n_s, fall_n_s: fastest change of the force where the wall changes, to more and to less. A
    hand that is pushed back fast wastes the tank's energy in its muscles, so the rise is slow.
    back_m_s: while the tank cannot pay for all the way back, a hand that is pushed back this fast
    halves the rise.
    late_ns, hurry_ns: in the first `hurry_ns` a wall that was lost comes back. The rise does not
    save energy then, and after `late_ns` it is the faster, the later it is.
    most_rate_n_s: fastest change of the force for any reason.
    soften_s: the stiffness under load follows a new one with this time constant.
    steepest_n_m: where the tank does not pay for the wall's spring, one of up to this stiffness has
    the same force and stores less. It feels as stiff to a hand that keeps still.
    acceleration_m_s2: greatest acceleration of the handle; it bounds the next cycle's distance.
    velocity_s: time constant of the velocity that a fade uses.
    old_ns: a wall that nobody has repeated for so long fades out.
    """

    robot_n_m: float = 1000.0
    start_j: float = 0.05
    limit_j: float = 0.3
    rise_n_s: float = 25.0
    fall_n_s: float = 100.0
    back_m_s: float = 0.015
    late_ns: int = 375 * NS_PER_MS
    hurry_ns: int = 2 * NS_PER_S
    most_rate_n_s: float = 1000.0
    soften_s: float = 0.1
    steepest_n_m: float = 0.0
    acceleration_m_s2: float = 150.0
    velocity_s: float = 0.002
    old_ns: int = 5 * NS_PER_S


class WallRenderer:
    """Call `handle_wall` for each message, and `step` once a millisecond for the force.

    limit_n: the greatest force (N) now; set it before a step.
    kept_j: what the tank keeps for other forces; a steeper spring leaves it. Set it before a step.
    force_n: the present force on the handle (N, N).
    tank_j: energy taken from the hand less energy given to it, bounded by `limit_j`.
    least_j: the lowest value of `tank_j` so far.
    given_j: energy that the spring gave to the hand in the last step, or took if negative.
    used, stale: messages taken, and messages that were not newer than one before.
    """

    def __init__(self, model: RendererModel | None = None) -> None:
        self.model = model = model or RendererModel()
        self.limit_n = 12.0
        self.kept_j = 0.0
        self.tank_j = self.least_j = model.start_j
        self.given_j = 0.0
        self.used = self.stale = 0
        self._goal: Wall | None = None
        self._stamp_ms: int | None = None
        self._age_ns = self._life_ns = 0
        #: The plane that is rendered: its inward normal, the stiffness that is felt at rest and the
        #: one of the spring, and where along the normal its force begins.
        self._inward, self._stiffness, self._spring_n_m = (1.0, 0.0), 0.0, 0.0
        self._from_m = 0.0
        #: The present force on the handle (N, N).
        self.force_n = (0.0, 0.0)
        self._last: tuple[float, float] | None = None
        self._vx = self._vy = 0.0

    @property
    def spare_j(self) -> float:
        """What the tank holds beyond the need of the wall's present force."""
        fx, fy = self.force_n
        if fx == fy == 0.0:
            return self.tank_j
        return max(0.0, self.tank_j - (fx * fx + fy * fy) / (2.0 * self._spring_n_m))

    def handle_wall(self, message: WallMessage) -> None:
        """Take a message. One that is not newer than the last counts as stale and changes nothing.

        After a silence as long as the age limit any stamp counts: the ground's clock began anew.
        """
        stamp_ms = self._stamp_ms
        if stamp_ms is not None and self._age_ns <= self.model.old_ns:
            ahead_ms = (message.stamp_ms - stamp_ms) % STAMP_MODULUS_MS
            if ahead_ms == 0 or ahead_ms >= STAMP_MODULUS_MS // 2:
                self.stale += 1
                return
        self.used += 1
        self._stamp_ms, self._age_ns, self._goal = message.stamp_ms, 0, message.wall

    def handle_flow(self, energy_j: float) -> None:
        """Count energy that the motors gave to the hand, or took if negative."""
        self.tank_j = tank_j = min(self.tank_j - energy_j, self.model.limit_j)
        if tank_j < self.least_j:
            self.least_j = tank_j

    def step(self, x_m: float, y_m: float, dt_ns: int, *, felt: bool = True) -> tuple[float, float]:
        """Return the force (N, N) on the handle at (x_m, y_m) until the next step.

        dt_ns: since the last step. felt: False fades the force out; the wall stays known.
        The first step returns no force.
        """
        dt_s = dt_ns / NS_PER_S
        self._age_ns += dt_ns
        self._life_ns += dt_ns
        last, self._last = self._last, (x_m, y_m)
        self.given_j = 0.0
        if last is None:
            return 0.0, 0.0
        held_x, held_y = self.force_n
        dx, dy = x_m - last[0], y_m - last[1]
        self.given_j = held_x * dx + held_y * dy
        self.handle_flow(self.given_j)
        share = 1.0 / (dt_s + self.model.velocity_s)
        self._vx += (dx - self._vx * dt_s) * share
        self._vy += (dy - self._vy * dt_s) * share
        # What the spring does by itself.
        nx, ny = self._inward
        force = self._spring_n_m * (nx * x_m + ny * y_m - self._from_m)
        goal = self._goal if felt and self._age_ns <= self.model.old_ns else None
        if force <= 0.0:
            force = 0.0
            self._place(goal, x_m, y_m)
            nx, ny = self._inward
        fx, fy = -force * nx, -force * ny
        wanted_x = wanted_y = 0.0
        if goal is not None:
            if force:
                self._soften(self._series(goal), force, dt_s)
            wanted = self._stiffness * max(0.0, goal.depth_m(x_m, y_m))
            nx, ny = goal.inward
            wanted_x, wanted_y = -wanted * nx, -wanted * ny
        more = wanted_x * wanted_x + wanted_y * wanted_y > force * force
        rate = self.model.rise_n_s if more else self.model.fall_n_s
        if more and self._life_ns <= self.model.hurry_ns:
            rate *= max(1.0, self._life_ns / self.model.late_ns)
        elif more and goal is not None:
            out_m_s = -(nx * dx + ny * dy) / dt_s
            if out_m_s > 0.0 and not self._pays_back(goal.depth_m(x_m, y_m), force):
                rate *= self.model.back_m_s / (self.model.back_m_s + out_m_s)
        fx, fy = _towards(fx, fy, wanted_x, wanted_y, rate * dt_s)
        fx, fy = _towards(held_x, held_y, fx, fy, self.model.most_rate_n_s * dt_s)
        force = hypot(fx, fy)
        if force > 0.0:
            self._steepen(force)
            self._inward = nx, ny = -fx / force, -fy / force
            force = self._bounded(force, (nx * dx + ny * dy) / dt_s)
        if force > 0.0:
            self.force_n = -force * nx, -force * ny
            self._from_m = nx * x_m + ny * y_m - force / self._spring_n_m
        else:
            self.force_n = 0.0, 0.0
        return self.force_n

    def press_n(self, x_m: float, y_m: float) -> float:
        """Return how hard a robot presses on the newest wall that rests at this told place."""
        goal = self._goal
        if goal is None or self._age_ns > self.model.old_ns:
            return 0.0
        return self._series(goal) * max(0.0, goal.depth_m(x_m, y_m))

    def out_m(self, force_n: float) -> tuple[float, float]:
        """Return the way (m, m) out of the newest wall by which that press falls by `force_n`."""
        goal = self._goal
        if goal is None or force_n <= 0.0:
            return 0.0, 0.0
        way_m, (nx, ny) = force_n / self._series(goal), goal.inward
        return -way_m * nx, -way_m * ny

    def _series(self, wall: Wall) -> float:
        robot = self.model.robot_n_m
        return wall.stiffness_n_m * robot / (wall.stiffness_n_m + robot)

    def _place(self, goal: Wall | None, x_m: float, y_m: float) -> None:
        """Take the newest wall while there is no force. It begins at a handle that is inside."""
        if goal is None:
            self._stiffness = self._spring_n_m = 0.0
            return
        self._inward = nx, ny = goal.inward
        self._stiffness = self._spring_n_m = self._series(goal)
        self._from_m = max(nx * x_m + ny * y_m, goal.distance_m)

    def _pays_back(self, depth_m: float, force: float) -> bool:
        """Whether the tank pays for a hand that goes back against `force` to where the wall is."""
        stiffness = self._stiffness
        if not stiffness:
            return True
        rest_m = force / stiffness
        return force * (max(0.0, depth_m - rest_m) + rest_m / 2.0) <= self.tank_j - self.kept_j

    def _soften(self, stiffness: float, force: float, dt_s: float) -> None:
        """Let the stiffness follow at the same force; a softer spring stores more energy."""
        before = self._stiffness
        after = before + (stiffness - before) * dt_s / (dt_s + self.model.soften_s)
        if force * force <= 2.0 * after * self.tank_j:
            self._stiffness = after

    def _steepen(self, force: float) -> None:
        """Choose the spring whose energy at this force the tank pays for, as soft as the wall."""
        tank_j = self.tank_j - self.kept_j
        steepest = max(self._stiffness, self.model.steepest_n_m)
        need_n_m = force * force / (2.0 * tank_j) if tank_j > 0.0 else steepest
        self._spring_n_m = min(max(self._stiffness, need_n_m), steepest)

    def _bounded(self, force: float, in_m_s: float) -> float:
        """Return what of `force` the tank pays for while it fades by `most_rate_n_s` at most."""
        model, tank_j = self.model, max(0.0, self.tank_j)
        away_m_s = max(0.0, -(self._inward[0] * self._vx + self._inward[1] * self._vy))
        # A hand that runs away outruns the fastest fade.
        yielding = 1.0 / self._spring_n_m + max(0.0, away_m_s - _SLOW_M_S) / model.most_rate_n_s
        most = sqrt(2.0 * tank_j / yielding)
        least = hypot(*self.force_n) - model.most_rate_n_s * _CYCLE_S
        if most < least <= force and self._fastest_fade_j(least, max(0.0, -in_m_s)) <= tank_j:
            most = least
        force = min(force, self.limit_n, most)
        # The next cycle is held, and the handle may accelerate.
        out_m = (model.acceleration_m_s2 * _CYCLE_S - in_m_s) * _CYCLE_S
        if force * out_m > tank_j:
            force = tank_j / out_m
        return force

    def _fastest_fade_j(self, force: float, away_m_s: float) -> float:
        """Return what the fastest fade of `force` gives to a hand that goes away, ever faster."""
        fade_s = force / self.model.most_rate_n_s
        return force * fade_s * (away_m_s / 2.0 + _RELEASED_M_S2 * fade_s / 6.0)


def _towards(x: float, y: float, to_x: float, to_y: float, most: float) -> tuple[float, float]:
    """Return the vector (x, y), moved to (to_x, to_y) by `most` at most."""
    dx, dy = to_x - x, to_y - y
    size = hypot(dx, dy)
    if size <= most:
        return to_x, to_y
    return x + dx * most / size, y + dy * most / size


_tuple = tuple.__new__
#: Less and slower damping than `direct`: the wall's force takes its energy from the tank, not from
#: the robot.
_MODEL = JoystickControllerModel(most_damping_n_s_m=8.0, damping_s=0.2)
_RENDERING = RendererModel(limit_j=0.5, steepest_n_m=5000.0)
#: Fastest change of wall and rest together, and with the damping.
_MOST_N_S, _ALL_N_S = 1000.0, 1090.0
#: What the rest may give out at first beyond what the hand put in. The robot never gets it.
_START_J = 0.003
#: Damping at the start, until the robot is heard or a wall is felt, and its longest time. A hand
#: that has lost its wall sinks in against it, and so pays for the wall that comes back.
_BRAKE_N_S_M, _BRAKE_S = 120.0, 0.5
#: Time constants with which a place that is too deep is held back, and told again.
_HOLD_BACK_S, _FOLLOW_S = 0.3, 0.05
#: Filtered speed after the first cycle of a handle that moves already.
_MOVES_M_S = 0.01


class MediatedController(JoystickController):
    """A `JoystickController` whose force is that of the newest wall. Call `handle_wall` for each.

    residual: the feedback is what the wall does not explain, and is displayed, too.
    adaptive: a `JoystickController` until the first wall comes.
    renderer: what it renders with. garbage: messages that were not a wall.
    """

    def __init__(
        self,
        model: JoystickControllerModel | None = None,
        *,
        passive: bool = True,
        residual: bool = False,
        adaptive: bool = False,
    ) -> None:
        super().__init__(model, passive=passive)
        self._model, self._rendering = model or _MODEL, False
        self.residual = residual
        self.renderer = WallRenderer(_RENDERING)
        self.garbage = 0
        self._damping_n = (0.0, 0.0)
        self._heard, self._braking = False, True
        #: The robot may not know the wall that is rendered: one of the two has just started.
        self._unknown = True
        self._before: tuple[float, float] | None = None
        if not adaptive:
            self._render()

    def _render(self) -> None:
        """From now on walls are rendered."""
        self._rendering, self.model, self.spared_j = True, self._model, 0.002 + _START_J
        self._out = None
        if self.passive:
            self.port.kept_j += _START_J
            self.port.credit_j += _START_J

    @property
    def robot_force_n(self) -> tuple[float, float]:
        """The part of the present force (N, N) that is the robot's; the rest is damping."""
        wall_x, wall_y = self.renderer.force_n
        return wall_x + self._gx, wall_y + self._gy

    def handle_wall(self, datagram: bytes) -> None:
        """A message of the robot's side arrived. Garbage is counted; this never raises."""
        try:
            message = parse_wall(datagram)
        except ProtocolError:
            self.garbage += 1
            return
        if not self._rendering:
            self._render()
        # What comes before the robot is heard may be of its earlier start.
        self._unknown = self._unknown and not self._heard
        self.renderer.handle_wall(message)

    def handle_restart(self) -> None:
        """The robot has started. Its feedback is the whole force until it tells a wall again."""
        self._unknown = True

    def step(
        self, feedback: Feedback | None, x_m: float, y_m: float, dt_ns: int
    ) -> tuple[float, float]:
        """As in `JoystickController`; the force of `feedback` counts with `residual` only."""
        if not self._rendering:
            return super().step(feedback, x_m, y_m, dt_ns)
        renderer, limit_n = self.renderer, self.limit_n
        before, self._before = self._before, (x_m, y_m)
        if before is not None:
            bx, by = self._damping_n
            renderer.handle_flow(bx * (x_m - before[0]) + by * (y_m - before[1]))
        renderer.limit_n = limit_n
        # A wall that rises must leave what the rest needs to fade.
        renderer.kept_j = self._fade_j()
        felt = feedback is None or not feedback[7]
        held_x, held_y = renderer.force_n
        wall_x, wall_y = renderer.step(x_m, y_m, dt_ns, felt=felt)
        turned_n_s = hypot(wall_x - held_x, wall_y - held_y) * NS_PER_S / dt_ns
        self.rate_n_s = max(0.0, min(self.model.rate_n_s, _MOST_N_S - turned_n_s))
        self.most_rate_n_s = max(0.0, _ALL_N_S - turned_n_s)
        if feedback is not None and (not self.residual or (self._unknown and (wall_x or wall_y))):
            feedback = _tuple(Feedback, (0.0, 0.0, *feedback[2:]))
        # Rounding must not make it negative.
        self.limit_n = max(0.0, limit_n - hypot(wall_x, wall_y))
        self.most_j = renderer.spare_j
        self._damping_n = bx, by = super().step(feedback, x_m, y_m, dt_ns)
        self.limit_n = limit_n
        self._bound_press(x_m, y_m, dt_ns / NS_PER_S)
        return wall_x + bx, wall_y + by

    def _note_press(self, feedback: Feedback) -> None:
        if not self._rendering:
            super()._note_press(feedback)

    def _bound_press(self, x_m: float, y_m: float, dt_s: float) -> None:
        """Hold back by what the rendered wall says, which is no round trip old."""
        renderer, (back_x, back_y) = self.renderer, self.held_back_m
        presses_n = max(
            renderer.press_n(x_m + back_x, y_m + back_y), hypot(self._goal_x, self._goal_y)
        )
        gives_n = hypot(*self.robot_force_n)
        self._compare(presses_n, gives_n)
        if self.limit_n <= 0.0:
            self.held_back_m = 0.0, 0.0
            return
        to_x, to_y = renderer.out_m(renderer.press_n(x_m, y_m) - self.most_press_n(gives_n))
        more = to_x * to_x + to_y * to_y > back_x * back_x + back_y * back_y
        share = dt_s / (dt_s + (_HOLD_BACK_S if more else _FOLLOW_S))
        self.held_back_m = back_x + (to_x - back_x) * share, back_y + (to_y - back_y) * share

    def _follow_credit(self, feedback: Feedback | None, dt_s: float) -> None:
        if self._braking:
            self.damping_n_s_m = self.model.damping_n_s_m
        super()._follow_credit(feedback, dt_s)
        self._heard = self._heard or feedback is not None
        if not self._braking:
            return
        known = self._heard or self.renderer.force_n != (0.0, 0.0)
        # A hand that moves already, or turns back, leans on no wall.
        moves = self._silent_s <= dt_s and hypot(self._vx, self._vy) > _MOVES_M_S
        turns = self._bx * self._vx + self._by * self._vy > 0.0
        self._braking = not (known or moves or turns or self._silent_s > _BRAKE_S)
        if self._braking:
            self.damping_n_s_m = _BRAKE_N_S_M

    def _book(self, energy_j: float) -> None:
        """Count wall and damping together: what the wall gives back, the damper takes."""
        given_j = self.renderer.given_j
        # The tank pays for the rest of it.
        super()._book(energy_j + min(given_j, max(0.0, -energy_j)))
