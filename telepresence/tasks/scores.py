"""How well a task was done: path, forces and errors while the cosmonaut drove. A core."""

from dataclasses import dataclass
from math import hypot

from telepresence.haptics.board import LIGHTS_M
from telepresence.tasks.definitions import Curve, Elemop, Follow, Pull, Pursue, Reach
from telepresence.tasks.panel_picture import PanelPicture
from telepresence.tasks.positions import curve_points, distance_m


@dataclass(frozen=True, kw_only=True, slots=True)
class Scores:
    """path_m: of the tip. force_max_n, force_mean_n: of the board on it.

    other_force_max_n, other_force_mean_n: on the hand of the partner's arm; None without one.
    error_mean, error_max: distance from what was to be followed (m), or from the force that was to
    be held (N, for a spring); None where nothing was.
    """

    path_m: float
    force_max_n: float
    force_mean_n: float
    other_force_max_n: float | None
    other_force_mean_n: float | None
    error_mean: float | None
    error_max: float | None


class ScoreKeeper:
    """Takes the robot's state a hundred times a second, or as often as it is known."""

    def __init__(self) -> None:
        self._last: tuple[float, float] | None = None
        self._path_m = self._force_sum_n = self._force_max_n = 0.0
        self._error_sum = self._error_max = 0.0
        self._samples = self._errors = self._others = 0
        self._other_sum_n = self._other_max_n = 0.0
        self._pulled = False
        self._curves: dict[Curve, list[tuple[float, float]]] = {}

    def handle_robot(
        self,
        x_m: float,
        y_m: float,
        push_n: float,
        elemop: Elemop | None,
        picture: PanelPicture,
        other_n: float | None = None,
    ) -> None:
        """The tip is at (x_m, y_m), and the board pushes it with `push_n`.

        elemop: what the kernel waits for. picture: of the LED panel. other_n: the force on the
        partner's hand.
        """
        if other_n is not None:
            self._others += 1
            self._other_sum_n += other_n
            self._other_max_n = max(self._other_max_n, other_n)
        if self._last is not None:
            self._path_m += hypot(x_m - self._last[0], y_m - self._last[1])
        self._last = x_m, y_m
        self._samples += 1
        self._force_sum_n += push_n
        self._force_max_n = max(self._force_max_n, push_n)
        error = self._error(x_m, y_m, push_n, elemop, picture)
        if error is not None:
            self._errors += 1
            self._error_sum += error
            self._error_max = max(self._error_max, error)

    def report(self) -> Scores:
        """Return the scores so far, rounded."""
        count, errors, others = max(1, self._samples), self._errors, self._others
        return Scores(
            path_m=round(self._path_m, 4),
            force_max_n=round(self._force_max_n, 3),
            force_mean_n=round(self._force_sum_n / count, 3),
            other_force_max_n=round(self._other_max_n, 3) if others else None,
            other_force_mean_n=round(self._other_sum_n / others, 3) if others else None,
            error_mean=round(self._error_sum / errors, 6) if errors else None,
            error_max=round(self._error_max, 6) if errors else None,
        )

    @property
    def words(self) -> str:
        """The scores so far, in one line for people."""
        scores = self.report()
        path = f"{scores.path_m * 100:.0f} cm of path"
        if scores.error_mean is None:
            return path
        off = f"{scores.error_mean:.1f} N" if self._pulled else f"{scores.error_mean * 1e3:.1f} mm"
        return f"{off} off on average, {path}"

    def _error(
        self, x_m: float, y_m: float, push_n: float, elemop: Elemop | None, picture: PanelPicture
    ) -> float | None:
        if isinstance(elemop, Reach):
            x, y = LIGHTS_M[elemop.led]
            return hypot(x_m - x, y_m - y)
        if isinstance(elemop, Pursue):
            return hypot(x_m - picture.spot_m[0], y_m - picture.spot_m[1])
        if isinstance(elemop, Follow):
            points = self._curves.setdefault(elemop.curve, curve_points(elemop.curve))
            return distance_m(points, x_m, y_m, closed=elemop.curve is Curve.CONTOUR)
        if isinstance(elemop, Pull):
            self._pulled = True
            return abs(push_n - elemop.force_n)
        return None
