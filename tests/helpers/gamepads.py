"""Game controllers as the kernel describes them, and a device around a stick without a kernel."""

from kontur_av.clock import NS_PER_MS
from telepresence.haptics.axes import AXIS_NAMES
from telepresence.haptics.device.stick import Axis, Stick

KEYS = frozenset({0x130, 0x131, 0x133, 0x134, 0x136})
AXES = {0: Axis(128, 0, 255, 15), 1: Axis(0, -32768, 32767, 128)}
SIDE = Axis(0, -32768, 32767, 128)
TRIGGER, HAT = Axis(0, 0, 255), Axis(0, -1, 1)
STICKS = {0: SIDE, 1: SIDE}
HATS = {0x10: HAT, 0x11: HAT}
#: What controllers have: their axes and buttons by code, and the axes that these lead.
CONTROLLERS = {
    "pad": (STICKS | HATS | {2: TRIGGER, 3: SIDE, 4: SIDE, 5: TRIGGER}, KEYS, AXIS_NAMES),
    "old pad": (STICKS | HATS | {2: SIDE, 5: SIDE}, KEYS | {0x138, 0x139}, AXIS_NAMES),
    "small pad": (STICKS, KEYS | {0x138, 0x139}, ("gripper",)),
    "joystick": (STICKS | {5: SIDE, 6: SIDE}, frozenset({0x120, 0x121}), ("z", "yaw")),
    "plain": (STICKS, frozenset({0x120}), ()),
}


class Pad:
    """A device around a `Stick`, without a kernel device."""

    def __init__(self):
        self.stick = Stick("pad", AXES, KEYS)
        self.capabilities = self.stick.capabilities
        self.read, self.set_zero = self.stick.reading, self.stick.handle_zero
        self.advance = self.stick.advance
        self.write_force = lambda x_n, y_n: None
        self.write_leds = self.show_state = lambda _: None


def settled(stick):
    """Return what a stick reads once the handle has followed it."""
    for _ in range(300):
        stick.advance(NS_PER_MS)
    return stick.reading()
