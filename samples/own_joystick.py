"""A joystick of your own: a lever with motors. In `HeldLever` a simulated hand leads it.

    kontur-av joystick check own_joystick:Lever
    kontur-av simulate --setup taskboard --seconds 20 --no-media --joystick own_joystick:HeldLever

in this file's directory. A driver of a real joystick has the same methods; `docs/drivers.md` says
what each is for.
"""

from math import pi, sin

from telepresence import JoystickCapabilities, JoystickReading

MASS_KG, FRICTION_N_S_M, HALF_M, LIMIT_N = 0.4, 2.0, 0.1, 8.0
HAND_N_M, HAND_N_S_M, WAY_M, PERIOD_S = 60.0, 6.0, 0.08, 4.0


class Lever:
    """A `JoystickDevice` with two axes and no buttons but the dead-man button.

    Its button is the person's: `button` is what the switch reads, and nothing else presses it.
    """

    capabilities = JoystickCapabilities(
        name="a lever",
        half_width_m=HALF_M,
        half_height_m=HALF_M,
        force_limit_n=LIMIT_N,
        mass_kg=MASS_KG,
        viscous_n_s_m=FRICTION_N_S_M,
    )

    def __init__(self) -> None:
        self.place, self.speed = [0.0, 0.0], [0.0, 0.0]
        self.force, self.age_s = [0.0, 0.0], 0.0
        self.zero = [0.0, 0.0]
        self.button = False
        self.present = True

    def read(self) -> JoystickReading:
        x, y = (place - zero for place, zero in zip(self.place, self.zero, strict=True))
        return JoystickReading(x, y, *self.speed, dead_man=self.button, present=self.present)

    def set_zero(self, x_m: float, y_m: float) -> None:
        self.zero = [self.zero[0] + x_m, self.zero[1] + y_m]

    def write_force(self, x_n: float, y_n: float) -> None:
        self.force, self.age_s = [max(-LIMIT_N, min(LIMIT_N, one)) for one in (x_n, y_n)], 0.0

    def write_leds(self, mask: int) -> None: ...

    def show_state(self, state: int) -> None: ...

    def hand(self, dt: float) -> list[float]:
        """The forces of a hand (N); nobody holds it."""
        return [0.0, 0.0]

    def advance(self, dt_ns: int) -> None:
        dt = dt_ns / 1e9
        self.age_s += dt
        if self.age_s > 0.05:
            self.force = [0.0, 0.0]
        hand = self.hand(dt)
        for axis in (0, 1):
            push = self.force[axis] + hand[axis] - FRICTION_N_S_M * self.speed[axis]
            self.speed[axis] += push / MASS_KG * dt
            self.place[axis] += self.speed[axis] * dt
            if abs(self.place[axis]) > HALF_M:
                self.place[axis] = max(-HALF_M, min(HALF_M, self.place[axis]))
                self.speed[axis] = 0.0

    def close(self) -> None:
        self.force, self.present, self.button = [0.0, 0.0], False, False


class HeldLever(Lever):
    """The same in a hand that holds it in the application: on virtual time, never for a robot."""

    held_s: float | None = None

    def show_state(self, state: int) -> None:
        self.held_s = 0.0 if state == 3 else None  # 3: application
        self.button = False

    def hand(self, dt: float) -> list[float]:
        if self.held_s is None:
            return [0.0, 0.0]
        self.held_s += dt
        # Pressed late, so that the session sees it released; and before the hand begins to move.
        self.button = self.held_s > 0.5
        way = WAY_M * sin(2 * pi * max(0.0, self.held_s - 1.0) / PERIOD_S)
        aims = (self.zero[0] + way, self.zero[1])
        return [
            HAND_N_M * (aims[axis] - self.place[axis]) - HAND_N_S_M * self.speed[axis]
            for axis in (0, 1)
        ]
