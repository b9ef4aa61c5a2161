"""A simulated joystick as a device: mechanics, motors, sensors, and the faults it may have.

Nobody's hand is on it, unless `hand` gives the force of one; a person whose fingers are on the
buttons answers the LEDs, as the check of the buttons asks for.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from kontur_av.clock import NS_PER_MS, NS_PER_S
from telepresence.haptics.device.device import DeviceFacts, Reading

FACTS = DeviceFacts(
    name="simulated joystick",
    half_width_m=0.1,
    half_height_m=0.08,
    force_limit_n=12.0,
    mass_kg=0.4,
    coulomb_n=0.25,
    viscous_n_s_m=0.8,
    buttons=4,
    leds=4,
)


@dataclass(frozen=True, kw_only=True, slots=True)
class Faults:
    """What may be broken. stuck: an axis, 0 or 1, that does not move. friction: how many times the
    due one. motor_gain: how much of the force that they are told the motors give. dead_button:
    its index, -1 for none. heat_c: by how much the motors are hotter than they should be.
    lost_ns: how long after it was switched on the plug is pulled.
    """

    stuck: int = -1
    friction: float = 1.0
    motor_gain: float = 1.0
    dead_button: int = -1
    heat_c: float = 0.0
    lost_ns: int | None = None


#: Faults by the name that a device's SPEC has for them, `sim:NAME`.
FAULTS: Mapping[str, Faults] = MappingProxyType(
    {
        "stuck-x": Faults(stuck=0),
        "stuck-y": Faults(stuck=1),
        "friction": Faults(friction=4.0),
        "weak": Faults(motor_gain=0.6),
        "button": Faults(dead_button=1),
        "hot": Faults(heat_c=70.0),
        "unplugged": Faults(lost_ns=8 * NS_PER_S),
    }
)

#: How long a person takes to see a light and press: simple reactions take 0.2 to 0.3 s (R. D. Luce,
#: "Response Times", 1986).
_REACTION_NS = 250 * NS_PER_MS


class Fingers:
    """A person who presses the button whose LED is lit, and the dead-man button when all are.

    buttons, dead_man: what is pressed now.
    """

    def __init__(self, leds: int) -> None:
        self.buttons = 0
        self.dead_man = False
        self._all = (1 << leds) - 1
        self._seen = 0
        self._since_ns = 0
        self._now_ns = 0

    def handle_leds(self, mask: int) -> None:
        """The LEDs change to `mask`."""
        self._seen, self._since_ns = mask, self._now_ns

    def advance(self, dt_ns: int) -> None:
        """`dt_ns` pass."""
        self._now_ns += dt_ns
        if self._now_ns - self._since_ns >= _REACTION_NS:
            self.dead_man = self._seen == self._all
            self.buttons = 0 if self.dead_man else self._seen


class SimulatedDevice:
    """A joystick that is calculated; `switched_on_m`: where its encoders began to count."""

    def __init__(
        self,
        faults: Faults | None = None,
        *,
        temperature_c: float = 22.0,
        start_m: tuple[float, float] = (0.013, -0.021),
    ) -> None:
        self.facts = FACTS
        self.faults = faults or Faults()
        self.fingers = Fingers(self.facts.leds)
        self.leds = 0
        self.force_x_n = self.force_y_n = 0.0
        self._x, self._y = start_m
        self._vx = self._vy = 0.0
        self._zero = start_m
        self._temperature_c = temperature_c
        self._now_ns = 0

    def read(self) -> Reading:
        faults = self.faults
        gone = faults.lost_ns is not None and self._now_ns >= faults.lost_ns
        buttons = self.fingers.buttons
        if faults.dead_button >= 0:
            buttons &= ~(1 << faults.dead_button)
        return Reading(
            self._x - self._zero[0],
            self._y - self._zero[1],
            self._vx,
            self._vy,
            buttons,
            self.fingers.dead_man,
            self._temperature_c + faults.heat_c,
            not gone,
        )

    def write_force(self, x_n: float, y_n: float) -> None:
        limit = self.facts.force_limit_n
        self.force_x_n = max(-limit, min(limit, x_n))
        self.force_y_n = max(-limit, min(limit, y_n))

    def write_leds(self, mask: int) -> None:
        self.leds = mask
        self.fingers.handle_leds(mask)

    def advance(self, dt_ns: int) -> None:
        self._now_ns += dt_ns
        self.fingers.advance(dt_ns)
        f = self.facts
        gain = self.faults.motor_gain
        dt = dt_ns / NS_PER_S
        self._x, self._vx = _axis(
            self._x, self._vx, gain * self.force_x_n, f.half_width_m, f, self.faults, dt
        )
        self._y, self._vy = _axis(
            self._y, self._vy, gain * self.force_y_n, f.half_height_m, f, self.faults, dt
        )
        if self.faults.stuck == 0:
            self._x, self._vx = self._zero[0], 0.0
        if self.faults.stuck == 1:
            self._y, self._vy = self._zero[1], 0.0

    def close(self) -> None:
        self.write_force(0, 0)
        self.write_leds(0)


def _axis(x, v, force, half, f, faults, dt):
    fc = f.coulomb_n * faults.friction
    force -= f.viscous_n_s_m * v
    if abs(x) > half:
        force -= 20000 * (x - (half if x > 0 else -half)) + 60 * v
    v += force / f.mass_kg * dt
    dv = fc / f.mass_kg * dt
    v = 0.0 if abs(v) <= dv else v - dv if v > 0 else v + dv
    return x + v * dt, v
