"""A robot of your own in a session: a mass of 1 kg, and a wall that it can touch.

    kontur-av stream --setup taskboard --robot own_robot:Mass

in this file's directory. A driver of a real robot has the same methods; `docs/robots.md` says when
each is called.
"""

from telepresence import RobotFacts, RobotReading

MASS_KG, FRICTION_N_S_M, WALL_X_M, WALL_N_M = 1.0, 2.0, 0.06, 600.0


class Mass:
    """A `RobotDevice` that takes forces."""

    facts = RobotFacts(name="a mass before a wall", force_limit_n=25.0)

    def __init__(self) -> None:
        self.x = self.y = self.vx = self.vy = 0.0
        self.force = (0.0, 0.0)
        self.active = False

    def configure(self) -> None: ...

    def power_on(self) -> None: ...

    def activate(self) -> None:
        self.active = True

    def deactivate(self) -> None:
        self.active, self.vx, self.vy = False, 0.0, 0.0

    def power_off(self) -> None: ...

    def wall(self) -> float:
        """The force of the wall along x (N)."""
        return min(0.0, WALL_N_M * (WALL_X_M - self.x))

    def read(self) -> RobotReading:
        push = self.wall()
        return RobotReading(self.x, self.y, self.vx, self.vy, push, 0.0, contact=push < 0.0)

    def write_force(self, x_n: float, y_n: float) -> None:
        self.force = (x_n, y_n)

    def write_position(self, x_m: float, y_m: float, vx_m_s: float, vy_m_s: float) -> None:
        raise NotImplementedError("it takes forces")

    def advance(self, dt_ns: int) -> None:
        if not self.active:
            return
        dt = dt_ns / 1e9
        self.vx += (self.force[0] + self.wall() - FRICTION_N_S_M * self.vx) / MASS_KG * dt
        self.vy += (self.force[1] - FRICTION_N_S_M * self.vy) / MASS_KG * dt
        self.x += self.vx * dt
        self.y += self.vy * dt
