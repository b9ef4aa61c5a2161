"""What of the LED panel shines on the task board."""

from functools import lru_cache

from telepresence.haptics.board import LIGHTS_M
from telepresence.tasks.definitions import Curve, Pattern
from telepresence.tasks.panel_picture import PanelPicture
from telepresence.tasks.places import curve_points
from telepresence.world.state import Lights

#: Lights along a curve, and of an LED or the spot (m).
_SMALL_M, _LARGE_M = 0.0016, 0.0055
#: Every so many points of a curve is a light.
_EVERY = 3
_SPRING_M = (-0.112, 0.0)


@lru_cache(maxsize=64)
def lights_of(picture: PanelPicture) -> Lights:
    """Return the lights of a picture; none while it is dark."""
    pattern, colour = picture.pattern, picture.colour
    if pattern is Pattern.LEDS:
        lit = tuple(place for k, place in enumerate(LIGHTS_M) if picture.leds >> k & 1)
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
