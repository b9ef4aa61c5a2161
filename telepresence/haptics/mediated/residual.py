"""What a wall that was told does not explain of the robot's measured force.

The joystick renders the wall, so the feedback carries only the rest: friction, a groove, another
person's hand, and all of a contact that nobody has told yet. So the model takes over from the
delayed force by itself, and the other way round when the tip contradicts it.
"""

from kontur_av.clock import NS_PER_MS
from telepresence.haptics.mediated.wall import Wall

#: A wall takes over within this time, about as fast as the renderer lets its force grow.
_TAKES_OVER_NS = 300 * NS_PER_MS


class Residual:
    """Call `rest_n` once a cycle with the newest wall that was told, or None."""

    def __init__(self) -> None:
        self._share = 0.0
        self._last_ns: int | None = None

    def rest_n(
        self,
        wall: Wall | None,
        x_m: float,
        y_m: float,
        fx_n: float,
        fy_n: float,
        now_ns: int,
    ) -> tuple[float, float]:
        """Return the part of the force (fx_n, fy_n) on the tip that `wall` does not explain."""
        last_ns, self._last_ns = self._last_ns, now_ns
        if wall is None:
            self._share = 0.0
            return fx_n, fy_n
        if last_ns is not None and self._share < 1.0:
            self._share = min(1.0, self._share + (now_ns - last_ns) / _TAKES_OVER_NS)
        wall_x, wall_y = wall.force_n(x_m, y_m)
        return fx_n - self._share * wall_x, fy_n - self._share * wall_y
