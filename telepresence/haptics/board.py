"""The task board as the tip feels it: a wall with the LED targets, a spring, a contour to follow.

All lengths are in metres, in the board's coordinates (see `telepresence.world.state`). Each
element exerts a force on the tip; the forces add up.
"""

from bisect import bisect_right
from dataclasses import dataclass
from functools import cache
from math import atan2, cos, hypot, pi, sin, sqrt, tau

#: The contact wall is the line x = WALL_X_M. The tip reaches it from smaller x.
WALL_X_M = 0.06
#: Centres of the LED targets: three on the wall, two that only the cameras see.
LEDS_M: tuple[tuple[float, float], ...] = (
    (WALL_X_M, -0.05),
    (WALL_X_M, 0.0),
    (WALL_X_M, 0.05),
    (-0.06, 0.05),
    (-0.06, -0.05),
)
#: The LED panel for tasks, within the contour: LED 0 in the middle, LEDs 1 to 7 on a circle.
LIGHTS_M: tuple[tuple[float, float], ...] = (
    (-0.045, 0.0),
    *((-0.045 + 0.042 * cos(pi + k * tau / 7), 0.042 * sin(pi + k * tau / 7)) for k in range(7)),
)
#: The line to trace, from its beginning to its end.
LINE_M: tuple[tuple[float, float], tuple[float, float]] = ((0.038, -0.07), (0.038, 0.07))
#: A contact within this distance of an LED's centre lights the LED.
LED_REACH_M = 0.012


@dataclass(frozen=True, kw_only=True, slots=True)
class WallModel:
    """A one-sided spring and damper: a Kelvin-Voigt contact that never pulls. All values chosen.

    stiffness_n_m: 0 to 5000.
    friction: Coulomb coefficient along the wall, smoothed over `stick_m_s`.
    """

    x_m: float = WALL_X_M
    stiffness_n_m: float = 1500.0
    damping_n_s_m: float = 20.0
    friction: float = 0.15
    stick_m_s: float = 0.01

    def __post_init__(self) -> None:
        if not 0.0 <= self.stiffness_n_m <= 5000.0:
            raise ValueError(f"a wall has 0 to 5000 N/m, not {self.stiffness_n_m:g}")


@dataclass(frozen=True, kw_only=True, slots=True)
class SpringModel:
    """A soft, lossless plate at the left edge: x below `x_m`, |y| within `half_height_m`.

    All values chosen.
    """

    x_m: float = -0.115
    half_height_m: float = 0.02
    stiffness_n_m: float = 200.0


@dataclass(frozen=True, kw_only=True, slots=True)
class ContourModel:
    """A groove of `half_width_m` along the drawn curve; its walls push the tip to its middle.

    The potential lies depth_j * (1 - (d / half_width)^2)^2 below the board's, where d is the
    distance from the curve. Force and stiffness are continuous at the edges. All values chosen.
    """

    half_width_m: float = 0.008
    depth_j: float = 0.004
    centre_x_m: float = -0.045


def contour_point(t: float) -> tuple[float, float]:
    """Return the point (x, y) of the drawn curve (m) at the angle `t` (rad)."""
    return (-0.045 + 0.068 * cos(t) - 0.008 * cos(3.0 * t), 0.070 * sin(t) + 0.006 * sin(3.0 * t))


def led_at(x_m: float, y_m: float) -> int | None:
    """Return the index into LEDS_M of the target that a contact at (x_m, y_m) lights, or None."""
    # The targets are too far apart for one contact to reach two of them.
    for index, (led_x, led_y) in enumerate(LEDS_M):
        dx, dy = x_m - led_x, y_m - led_y
        if dx * dx + dy * dy <= LED_REACH_M * LED_REACH_M:
            return index
    return None


@dataclass(frozen=True, slots=True)
class _Rays:
    """The curve's distance from its centre by direction: a table of one turn."""

    radii: tuple[float, ...]

    STEPS = 720

    @classmethod
    @cache
    def of_curve(cls) -> "_Rays":
        """The table of the drawn curve, which all boards share: it takes 5 ms to compute."""
        points = [contour_point(tau * k / 7200) for k in range(7200)]
        rays = sorted((atan2(y, x + 0.045) % tau, hypot(x + 0.045, y)) for x, y in points)
        angles = [angle for angle, _ in rays]
        steps = range(cls.STEPS + 1)
        return cls(
            tuple(rays[bisect_right(angles, tau * k / cls.STEPS) % len(rays)][1] for k in steps)
        )

    def at(self, angle: float) -> tuple[float, float]:
        """Return the radius (m) in the direction `angle` (rad), and its slope (m/rad)."""
        position = (angle % tau) * (self.STEPS / tau)
        index = min(int(position), self.STEPS - 1)
        low, high = self.radii[index], self.radii[index + 1]
        return low + (high - low) * (position - index), (high - low) * (self.STEPS / tau)


class Board:
    """Everything that the tip can touch.

    spring, contour: None leaves the element out.

    `press` sets these: wall_n: normal force of the wall (N), >= 0. touching: whether the tip is in
    the wall or in the spring.
    """

    def __init__(
        self,
        wall: WallModel | None = None,
        *,
        spring: SpringModel | None = SpringModel(),
        contour: ContourModel | None = ContourModel(),
    ) -> None:
        self.wall = wall or WallModel()
        self.spring = spring
        self.contour = contour
        self.wall_n = 0.0
        self.touching = False
        self._wall_x = self.wall.x_m
        # To the right of this line there is only the wall.
        self._left_x = 0.03 if spring or contour else -1.0
        self._rays = _Rays.of_curve() if contour else None

    def press(self, x_m: float, y_m: float, vx_m_s: float, vy_m_s: float) -> tuple[float, float]:
        """Return the board's force on the tip (N, N) at (x_m, y_m) with this velocity (m/s)."""
        self.touching = False
        depth = x_m - self._wall_x
        if depth > 0.0:
            wall = self.wall
            push = wall.stiffness_n_m * depth + wall.damping_n_s_m * vx_m_s
            push = push if push > 0.0 else 0.0
            # Coulomb friction, smoothed around standstill so that one step cannot overshoot it.
            rub = -wall.friction * push * vy_m_s / (abs(vy_m_s) + wall.stick_m_s)
            self.wall_n, self.touching = push, True
            return -push, rub
        self.wall_n = 0.0
        return self._left(x_m, y_m) if x_m < self._left_x else (0.0, 0.0)

    def _left(self, x: float, y: float) -> tuple[float, float]:
        fx = fy = 0.0
        spring, contour, rays = self.spring, self.contour, self._rays
        if spring is not None and x < spring.x_m and abs(y) < spring.half_height_m:
            fx = spring.stiffness_n_m * (spring.x_m - x)
            self.touching = True
        if contour is not None and rays is not None:
            dx = x - contour.centre_x_m
            radius = sqrt(dx * dx + y * y)
            if radius > 0.01:
                curve, slope = rays.at(atan2(y, dx))
                away = (radius - curve) / contour.half_width_m
                if -1.0 < away < 1.0:
                    push = -4.0 * contour.depth_j / contour.half_width_m * away * (1 - away * away)
                    # The gradient of radius - curve(angle).
                    turn = slope / (radius * radius)
                    fx += push * (dx / radius + y * turn)
                    fy += push * (y / radius - dx * turn)
        return fx, fy
