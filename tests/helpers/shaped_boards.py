"""Boards for tests whose only wall is slanted or round, with the default wall's spring and rub."""

from math import cos, hypot, sin

from telepresence.haptics.board import WallModel


class SlantedBoard:
    """A half plane that a tip meets on its way to `angle_rad`; see `Board` for what `press` sets.

    distance_m: from the origin, along that direction.
    """

    def __init__(
        self, angle_rad: float, distance_m: float = 0.03, *, wall: WallModel | None = None
    ) -> None:
        self.wall = wall or WallModel()
        self.inward = cos(angle_rad), sin(angle_rad)
        self.distance_m = distance_m
        self.wall_n = 0.0
        self.touching = False

    def surface(self, x_m: float, y_m: float) -> tuple[float, float, float]:
        """Return the depth (m) of the point, and the inward normal where it is nearest."""
        nx, ny = self.inward
        return nx * x_m + ny * y_m - self.distance_m, nx, ny

    def press(self, x_m: float, y_m: float, vx_m_s: float, vy_m_s: float) -> tuple[float, float]:
        """Return the board's force on the tip (N, N)."""
        depth, nx, ny = self.surface(x_m, y_m)
        self.touching = depth > 0.0
        self.wall_n = 0.0
        if not self.touching:
            return 0.0, 0.0
        wall = self.wall
        into, along = nx * vx_m_s + ny * vy_m_s, nx * vy_m_s - ny * vx_m_s
        push = max(0.0, wall.stiffness_n_m * depth + wall.damping_n_s_m * into)
        rub = -wall.friction * push * along / (abs(along) + wall.stick_m_s)
        self.wall_n = push
        return -push * nx - rub * ny, -push * ny + rub * nx


class RoundBoard(SlantedBoard):
    """A disc of `radius_m` whose nearest point lies where the half plane's would."""

    def __init__(self, angle_rad: float, distance_m: float = 0.03, *, radius_m: float) -> None:
        super().__init__(angle_rad, distance_m)
        self.radius_m = radius_m
        nx, ny = self.inward
        self.centre_m = nx * (distance_m + radius_m), ny * (distance_m + radius_m)

    def surface(self, x_m: float, y_m: float) -> tuple[float, float, float]:
        """Return the depth (m) of the point, and the inward normal where it is nearest."""
        dx, dy = self.centre_m[0] - x_m, self.centre_m[1] - y_m
        far = hypot(dx, dy)
        return self.radius_m - far, dx / far, dy / far
