"""Where things are on the task board, for tasks: LEDs, paths, the lights of the LED panel."""

from functools import lru_cache
from math import cos as cosine
from math import hypot, pi, sin, tau

from telepresence.haptics.board import LIGHTS_M, LINE_M, contour_point
from telepresence.tasks.definitions import Curve, Pattern, SpotPath
from telepresence.tasks.panel_picture import PanelPicture
from telepresence.world.state import Lights

Position = tuple[float, float]

#: Half width and half height of the spot's paths around LED 0 (m).
_SPOT_M = (0.032, 0.024)
#: A curve is checked at this many points.
CURVE_POINTS = 120


def spot_at(path: SpotPath, phase: float) -> Position:
    """The spot after `phase` turns of its path; it begins near LED 0 or on the circle."""
    centre_x, centre_y = LIGHTS_M[0]
    width, height = _SPOT_M
    angle = tau * phase
    if path is SpotPath.CIRCLE:
        return centre_x + height * sin(angle), centre_y + height * cosine(angle)
    return centre_x + width * sin(angle), centre_y + height * sin(2 * angle)


def curve_points(curve: Curve) -> list[Position]:
    """`CURVE_POINTS` points along the curve (m), in the order in which it is followed."""
    if curve is Curve.CONTOUR:
        return [contour_point(2 * pi * k / CURVE_POINTS) for k in range(CURVE_POINTS)]
    (x0, y0), (x1, y1) = LINE_M
    shares = [k / (CURVE_POINTS - 1) for k in range(CURVE_POINTS)]
    return [(x0 + (x1 - x0) * s, y0 + (y1 - y0) * s) for s in shares]


def goal_paths() -> dict[str, tuple[Position, ...]]:
    """By the name of a curve or a spot's path: points along it (m, to 0.1 mm)."""
    found = {curve.value: curve_points(curve)[::2] for curve in Curve}
    for path in SpotPath:
        found[path.value] = [spot_at(path, k / 60) for k in range(61)]
    return {name: tuple((round(x, 4), round(y, 4)) for x, y in way) for name, way in found.items()}


def distance_m(points: list[Position], x_m: float, y_m: float, *, closed: bool) -> float:
    """The distance of (x_m, y_m) from the polyline through `points`."""
    index = min(
        range(len(points)), key=lambda k: (points[k][0] - x_m) ** 2 + (points[k][1] - y_m) ** 2
    )
    least = hypot(points[index][0] - x_m, points[index][1] - y_m)
    for step in (-1, 1):
        other = index + step
        if closed:
            other %= len(points)
        if 0 <= other < len(points):
            least = min(least, _to_segment(points[index], points[other], x_m, y_m))
    return least


def _to_segment(a: Position, b: Position, x: float, y: float) -> float:
    dx, dy = b[0] - a[0], b[1] - a[1]
    share = ((x - a[0]) * dx + (y - a[1]) * dy) / (dx * dx + dy * dy)
    share = min(1.0, max(0.0, share))
    return hypot(a[0] + dx * share - x, a[1] + dy * share - y)


#: Lights along a curve, and of an LED or the spot (m).
_SMALL_M, _LARGE_M = 0.0016, 0.0055
#: One of this many points of a curve has a light.
_EVERY = 3
_SPRING_M = (-0.112, 0.0)


@lru_cache(maxsize=64)
def lights_of(picture: PanelPicture) -> Lights:
    """Return the lights of a picture; none while it is dark."""
    pattern, colour = picture.pattern, picture.colour
    if pattern is Pattern.LEDS:
        lit = tuple(position for k, position in enumerate(LIGHTS_M) if picture.leds >> k & 1)
        return Lights(lit, _LARGE_M, colour)
    if pattern is Pattern.SPOT:
        return Lights((picture.spot_m,), _LARGE_M, colour)
    if pattern in (Pattern.CONTOUR, Pattern.LINE):
        curve = Curve.CONTOUR if pattern is Pattern.CONTOUR else Curve.LINE
        return Lights(tuple(curve_points(curve)[::_EVERY]), _SMALL_M, colour)
    if pattern is Pattern.SPRING:
        return Lights((_SPRING_M,), _LARGE_M, colour)
    if pattern is Pattern.FREE:
        return Lights(LIGHTS_M, _SMALL_M, colour)
    return Lights()
