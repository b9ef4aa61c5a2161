"""A simulated human hand on the handle: the position it intends, and how stiffly it holds it.

The intended position follows a table of waypoints, joined by minimum-jerk movements (T. Flash and
N. Hogan, "The coordination of arm movements", J. Neurosci. 5, 1985). The muscles are a spring and a
damper between the handle and the intended position. The hand is passive around that position
(N. Hogan, "Controlling impedance at the man/machine interface", ICRA 1989).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot, inf
from typing import NamedTuple

from kontur_av.clock import NS_PER_MS, NS_PER_S


class Waypoint(NamedTuple):
    """Reach (x_m, y_m) `move_ns` after the previous waypoint, then stay for `stay_ns`."""

    x_m: float
    y_m: float
    move_ns: int
    stay_ns: int


def _tap(y_m: float) -> tuple[Waypoint, ...]:
    """2 s: approach the wall at x = 0.06 m at the height `y_m`, press, and retreat."""
    return (
        Waypoint(0.040, y_m, 350 * NS_PER_MS, 0),
        # Not a multiple of a camera's period, so that the touches sample all its phases.
        Waypoint(0.085, y_m, 500 * NS_PER_MS, 757 * NS_PER_MS),
        Waypoint(0.040, y_m, 400 * NS_PER_MS, 0),
    )


#: Press on the lowest, the middle, the upper and again the middle LED target: 8 s, four contacts.
TAP_TARGETS = (*_tap(-0.050), *_tap(0.0), *_tap(0.050), *_tap(0.0))

#: Approach the wall, press on the lowest LED target, slide along the wall to the middle and the
#: upper target, release and return: 9 s, one contact.
PRESS_AND_SLIDE = (
    Waypoint(0.000, -0.050, 1_200 * NS_PER_MS, 400 * NS_PER_MS),
    Waypoint(0.085, -0.050, 1_400 * NS_PER_MS, 800 * NS_PER_MS),
    Waypoint(0.085, 0.000, 900 * NS_PER_MS, 700 * NS_PER_MS),
    Waypoint(0.085, 0.050, 900 * NS_PER_MS, 800 * NS_PER_MS),
    Waypoint(0.010, 0.050, 900 * NS_PER_MS, 300 * NS_PER_MS),
    Waypoint(-0.060, 0.010, 700 * NS_PER_MS, 0 * NS_PER_MS),
)


@dataclass(frozen=True, kw_only=True, slots=True)
class HandModel:
    """Parameters of the arm behind the hand.

    stiffness_n_m, damping_n_s_m: muscles.
    mass_kg: the part of the hand or arm that moves with the handle.
    push_n: greatest force of the muscles' spring (N). A hand that is held back beyond it pushes
    with this constant force.

    The range follows T. Tsuji et al., "Human hand impedance characteristics during maintained
    posture", Biol. Cybern. 72, 1995: about 100 to 800 N/m, damping ratio 0.2 to 0.9. The mass of a
    hand without its arm is chosen.
    """

    stiffness_n_m: float
    damping_n_s_m: float
    mass_kg: float
    push_n: float = inf


#: A hand that hardly holds, one that yields, and one that holds tight.
LOOSE_GRIP = HandModel(stiffness_n_m=100.0, damping_n_s_m=8.0, mass_kg=0.2)
SOFT_GRIP = HandModel(stiffness_n_m=250.0, damping_n_s_m=15.0, mass_kg=0.2)
FIRM_GRIP = HandModel(stiffness_n_m=700.0, damping_n_s_m=35.0, mass_kg=0.4)
#: Arms behind a rigid grip, with a damping ratio of 0.3.
LIGHT_ARM = HandModel(stiffness_n_m=500.0, damping_n_s_m=13.0, mass_kg=1.0)
HEAVY_ARM = HandModel(stiffness_n_m=800.0, damping_n_s_m=24.0, mass_kg=2.0)
#: A constant push, as against a button.
PUSH = HandModel(stiffness_n_m=1000.0, damping_n_s_m=20.0, mass_kg=0.4, push_n=4.5)


#: What a person does, chosen: lets go this long after the robot was lost, takes so long to press
#: again, and to move from one to the next, and tries again if the robot does not follow by then.
_LOST_NS = 300 * NS_PER_MS
_AGAIN_NS = 500 * NS_PER_MS
_TIMEOUT_NS = 3 * NS_PER_S


class Grip:
    """The dead-man button in a person's hand: let go, and pressed anew, when the robot asks for it.

    pressed: it is pressed. following: the robot follows, as far as the person knows.

    A person who is never told of the robot presses all the time.
    """

    def __init__(self) -> None:
        self.pressed = self.following = True
        self._heard_ns = -_LOST_NS
        self._changed_ns = 0

    def let_go(self, now_ns: int) -> None:
        """Let go for a while."""
        self.pressed = self.following = False
        self._changed_ns = now_ns

    def press(self, now_ns: int) -> None:
        """Press, and see whether the robot follows."""
        self.pressed, self.following = True, False
        self._changed_ns = now_ns

    def handle_robot(self, heard: bool, waiting: bool, now_ns: int) -> None:
        """The robot is heard, and waits for a press."""
        if heard:
            self._heard_ns = now_ns
        lost = now_ns - self._heard_ns >= _LOST_NS
        since_ns = now_ns - self._changed_ns
        if self.following:
            if lost or waiting:
                self.let_go(now_ns)
        elif self.pressed:
            if lost or (waiting and since_ns > _TIMEOUT_NS):
                self.let_go(now_ns)
            elif not waiting:
                self.following = True
        elif heard and since_ns >= _AGAIN_NS:
            self.press(now_ns)


class Hand:
    """The simulated hand. `force` advances its intended position and returns its force.

    model: `SOFT_GRIP` by default.
    x_m, y_m, vx_m_s, vy_m_s: intended position and velocity.
    buttons: those that it presses beside the dead-man button, a mask.
    grip: on the dead-man button. While the robot does not follow, the hand waits where it did last.
    """

    buttons = 0

    def __init__(
        self, model: HandModel | None = None, *, script: Sequence[Waypoint] = TAP_TARGETS
    ) -> None:
        if not script or sum(point.move_ns + point.stay_ns for point in script) <= 0:
            raise ValueError("a script has at least one waypoint and takes some time")
        self.model = model = model or SOFT_GRIP
        self.script = tuple(script)
        self.mass_kg = model.mass_kg
        self.x_m, self.y_m = script[-1].x_m, script[-1].y_m
        self.vx_m_s = self.vy_m_s = 0.0
        self._stiffness, self._damping = model.stiffness_n_m, model.damping_n_s_m
        self._push_n = model.push_n
        self.grip = Grip()
        self._now_ns = 0
        self._index = 0
        self._into_ns = 0
        #: Where the handle was when the robot followed last; at first where a robot starts.
        self._place = (0.0, 0.0)
        #: Where a movement to the present waypoint began, if not at the one before.
        self._from: tuple[float, float] | None = None
        self._way: tuple[tuple[float, float], int] | None = None
        #: Duration of the current waypoint.
        self._point_ns = script[0].move_ns + script[0].stay_ns

    @property
    def period_ns(self) -> int:
        """Duration of the script before it begins again."""
        return sum(point.move_ns + point.stay_ns for point in self.script)

    def force(
        self, x_m: float, y_m: float, vx_m_s: float, vy_m_s: float, dt_ns: int
    ) -> tuple[float, float]:
        """Advance by `dt_ns`; return the force (N, N) on a handle at (x_m, y_m)."""
        self._now_ns += dt_ns
        if self.grip.following:
            self._follow_script(dt_ns)
        elif self._way is not None:
            (begin, since_ns), end = self._way, self._place
            self._move(begin, end, self._now_ns - since_ns, _AGAIN_NS)
        stiffness, damping = self._stiffness, self._damping
        pull_x, pull_y = stiffness * (self.x_m - x_m), stiffness * (self.y_m - y_m)
        if self._push_n < inf and (pull := hypot(pull_x, pull_y)) > self._push_n:
            pull_x *= self._push_n / pull
            pull_y *= self._push_n / pull
        return (
            pull_x + damping * (self.vx_m_s - vx_m_s),
            pull_y + damping * (self.vy_m_s - vy_m_s),
        )

    @property
    def dead_man(self) -> bool:
        """Whether it presses the dead-man button."""
        return self.grip.pressed

    def handle_robot(self, heard: bool, waiting: bool, x_m: float, y_m: float) -> None:
        """The robot is heard, or waits for a press; the handle is at (x_m, y_m)."""
        grip = self.grip
        followed = grip.following
        grip.handle_robot(heard, waiting, self._now_ns)
        if grip.following:
            if heard and not waiting:
                self._place = (x_m, y_m)
            if not followed:
                self._from, self._into_ns = (self.x_m, self.y_m), 0
        elif followed:
            self._way = (x_m, y_m), self._now_ns

    def see(self, x_m: float, y_m: float) -> None:
        """The robot's tip is at (x_m, y_m), in the picture: wait there for the next press."""
        if not self.grip.following:
            self._place = (x_m, y_m)

    def let_go(self, x_m: float, y_m: float) -> None:
        """Take the handle at (x_m, y_m), without the dead-man button at first."""
        self.grip.let_go(self._now_ns)
        self._way = (x_m, y_m), self._now_ns

    def _follow_script(self, dt_ns: int) -> None:
        self._into_ns += dt_ns
        while self._into_ns >= self._point_ns:
            self._into_ns -= self._point_ns
            self._index = (self._index + 1) % len(self.script)
            point = self.script[self._index]
            self._point_ns = point.move_ns + point.stay_ns
            self._from = None
        point, before = self.script[self._index], self.script[self._index - 1]
        begin = self._from or (before.x_m, before.y_m)
        self._move(begin, (point.x_m, point.y_m), self._into_ns, point.move_ns)

    def _move(
        self, begin: tuple[float, float], end: tuple[float, float], into_ns: int, lasts_ns: int
    ) -> None:
        if into_ns >= lasts_ns:
            self.x_m, self.y_m = end
            self.vx_m_s = self.vy_m_s = 0.0
            return
        s = into_ns / lasts_ns
        share = s * s * s * (10.0 + s * (6.0 * s - 15.0))
        rate = 30.0 * s * s * (1.0 - s) * (1.0 - s) * NS_PER_S / lasts_ns
        way_x, way_y = end[0] - begin[0], end[1] - begin[1]
        self.x_m, self.y_m = begin[0] + way_x * share, begin[1] + way_y * share
        self.vx_m_s, self.vy_m_s = way_x * rate, way_y * rate
