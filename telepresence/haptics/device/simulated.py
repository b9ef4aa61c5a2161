"""A simulated joystick as a device: mechanics, motors, sensors, and the faults it may have.

Nobody's hand is on it, unless `hand` gives the force of one; a person whose fingers are on the
buttons answers the LEDs, as the check of the buttons asks for.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
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

#: The force of a hand on the handle (N), given its place (m), its velocity (m/s) and how much
#: time passes (ns).
Hand = Callable[[float, float, float, float, int], tuple[float, float]]


@dataclass(frozen=True, kw_only=True, slots=True)
class Faults:
    """What may be broken. stuck: an axis, 0 or 1, that does not move. friction: how many times the
    due one. motor_gain: how much of the force that they are told the motors give. dead_button:
    its index, -1 for none. heat_c: by how much the motors are hotter than they should be. lost_ns: how
    long after it was switched on the plug is pulled.
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
