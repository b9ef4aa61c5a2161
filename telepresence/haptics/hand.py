"""A simulated human hand on the handle: where it means to be, and how hard it holds on to that.

The intention is a script: a table of waypoints, joined by movements of least jerk (T. Flash and
N. Hogan, "The coordination of arm movements", J. Neurosci. 5, 1985). Muscles are a spring and a
damper between handle and intention: the hand is passive around it (N. Hogan, "Controlling
impedance at the man/machine interface", ICRA 1989).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from kontur_av.clock import NS_PER_MS, NS_PER_S


class Waypoint(NamedTuple):
    """Be at (x_m, y_m) `move_ns` after the waypoint before, then stay for `stay_ns`."""

    x_m: float
    y_m: float
    move_ns: int
    stay_ns: int


def _tap(y_m: float) -> tuple[Waypoint, ...]:
    """2 s: across to `y_m` before the wall at x = 0.06 m, press there, and back from the wall."""
    return (
        Waypoint(0.040, y_m, 350 * NS_PER_MS, 0),
        # No multiple of a camera's period, or every touch would wait as long for its picture.
        Waypoint(0.085, y_m, 500 * NS_PER_MS, 757 * NS_PER_MS),
        Waypoint(0.040, y_m, 400 * NS_PER_MS, 0),
    )


#: Press on the lowest, the middle, the upper and again the middle LED target: 8 s, four contacts.
TAP_TARGETS = (*_tap(-0.050), *_tap(0.0), *_tap(0.050), *_tap(0.0))

#: Approach the wall, press on the lowest LED target, slide along the wall to the middle and the
#: upper one, let go and come back: 9 s, one contact.
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
    """What the arm behind the hand is made of.

    stiffness_n_m, damping_n_s_m: of the muscles. mass_kg: of the hand, what moves with the handle.
    The range is that of T. Tsuji et al., "Human hand impedance characteristics during maintained
    posture", Biol. Cybern. 72, 1995: some 100 to 800 N/m, damping ratio 0.2 to 0.9; the mass of a
    hand without its arm is chosen.
    """

    stiffness_n_m: float
    damping_n_s_m: float
    mass_kg: float


#: A hand that lets itself be led, and one that holds tight.
SOFT_GRIP = HandModel(stiffness_n_m=250.0, damping_n_s_m=15.0, mass_kg=0.2)
FIRM_GRIP = HandModel(stiffness_n_m=700.0, damping_n_s_m=35.0, mass_kg=0.4)

GRIPS = {"soft": SOFT_GRIP, "firm": FIRM_GRIP}


class Hand:
    """The hand; `force` moves its intention on and says how it pulls at the handle.

    model: `SOFT_GRIP` unless another is given. x_m, y_m, vx_m_s, vy_m_s: the intention.
    """

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
        self._index = 0
        self._into_ns = 0
        #: How long the present point takes.
        self._point_ns = script[0].move_ns + script[0].stay_ns

    @property
    def period_ns(self) -> int:
        """How long the script takes before it begins again."""
        return sum(point.move_ns + point.stay_ns for point in self.script)

    def force(
        self, x_m: float, y_m: float, vx_m_s: float, vy_m_s: float, dt_ns: int
    ) -> tuple[float, float]:
        """The hand's force on the handle (N, N), which is at (x_m, y_m), `dt_ns` later."""
        self._into_ns += dt_ns
        while self._into_ns >= self._point_ns:
            self._into_ns -= self._point_ns
            self._index = (self._index + 1) % len(self.script)
            point = self.script[self._index]
            self._point_ns = point.move_ns + point.stay_ns
        point = self.script[self._index]
        if self._into_ns >= point.move_ns:
            self.x_m, self.y_m = point.x_m, point.y_m
            self.vx_m_s = self.vy_m_s = 0.0
        else:
            before = self.script[self._index - 1]
            s = self._into_ns / point.move_ns
            share = s * s * s * (10.0 + s * (6.0 * s - 15.0))
            rate = 30.0 * s * s * (1.0 - s) * (1.0 - s) * NS_PER_S / point.move_ns
            way_x, way_y = point.x_m - before.x_m, point.y_m - before.y_m
            self.x_m, self.y_m = before.x_m + way_x * share, before.y_m + way_y * share
            self.vx_m_s, self.vy_m_s = way_x * rate, way_y * rate
        stiffness, damping = self._stiffness, self._damping
        return (
            stiffness * (self.x_m - x_m) + damping * (self.vx_m_s - vx_m_s),
            stiffness * (self.y_m - y_m) + damping * (self.vy_m_s - vy_m_s),
        )
