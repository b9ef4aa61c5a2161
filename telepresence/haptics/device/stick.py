"""What a game controller's events say: a core that is handed them as Linux has them.

Codes and their meaning: the kernel's `linux/input-event-codes.h` and "Linux Gamepad
Specification" (Documentation/input/gamepad.rst). A stick gives numbers of 8 to 16 bits at 125 to
1000 Hz, and springs back within a few milliseconds when it is let go: that would be a blow to the
robot, and more than the bilateral controller's bound of the next cycle allows for. So a handle with
a hand's speed and acceleration follows the stick.
"""

from math import sqrt
from typing import NamedTuple

from kontur_av.clock import NS_PER_MS, NS_PER_S
from telepresence.haptics.device.device import DeviceFacts, Reading

EV_SYN, EV_KEY, EV_ABS, EV_FF = 0x00, 0x01, 0x03, 0x15
SYN_DROPPED = 3
ABS_X, ABS_Y = 0x00, 0x01
FF_RUMBLE = 0x50
#: South, east, west, north of a gamepad; of a joystick the buttons under the thumb.
_PAD_BUTTONS = (0x130, 0x131, 0x134, 0x133)
_PAD_DEAD_MAN = 0x136  # BTN_TL, the left shoulder
_STICK_BUTTONS = (0x121, 0x122, 0x123, 0x124)
_STICK_DEAD_MAN = 0x120  # BTN_TRIGGER

#: What the full travel of a stick becomes: the simulated joystick's workspace.
HALF_WIDTH_M, HALF_HEIGHT_M = 0.1, 0.08
#: The last part of the way is gone with this time constant. Chosen: shorter than anybody notices,
#: longer than between two reports of a pad.
TAU_S = 0.015
#: On each axis. Both together stay below `JoystickControllerModel.acceleration_m_s2`.
ACCELERATION_M_S2 = 100.0
SPEED_M_S = 2.0
#: It brakes a little sooner than it has to: a cycle's rounding must not make it overshoot.
_BRAKING_M_S2 = 0.8 * ACCELERATION_M_S2
_CYCLE_S = NS_PER_MS / NS_PER_S


class Axis(NamedTuple):
    """What the kernel says of an axis: its range, and what around the middle means nothing."""

    value: int
    least: int
    most: int
    flat: int = 0


class Stick:
    """The left stick and the buttons of one controller, from its events.

    axes: what the kernel says of ABS_X and ABS_Y. keys: codes of all buttons that it has.
    Full travel is ±0.1 m along x and ±0.08 m along y, and up is +y. The dead-man button is the left
    shoulder (of a joystick: the trigger); a controller without it is held always.
    `needs_state`: events were lost, so ask the kernel and call `handle_state`.
    """

    def __init__(
        self, name: str, axes: tuple[Axis, Axis], keys: frozenset[int], *, rumble: bool = False
    ) -> None:
        buttons, dead_man = _PAD_BUTTONS, _PAD_DEAD_MAN
        if buttons[0] not in keys:
            buttons, dead_man = _STICK_BUTTONS, _STICK_DEAD_MAN
        self._bits = {
            code: 1 << index for index, code in enumerate(c for c in buttons if c in keys)
        }
        self._dead_man_code = dead_man if dead_man in keys else None
        self.facts = DeviceFacts(
            name=name,
            half_width_m=HALF_WIDTH_M,
            half_height_m=HALF_HEIGHT_M,
            buttons=len(self._bits),
            rumble=rumble,
        )
        self.needs_state = False
        self.present = True
        self._axes = axes
        self._raw = [axes[0].value, axes[1].value]
        self._buttons = 0
        self._dead_man = self._dead_man_code is None
        self._to_x, self._to_y = self._x, self._y = self._places()
        self._vx = self._vy = 0.0
        self._zero_x = self._zero_y = 0.0

    def handle_event(self, kind: int, code: int, value: int) -> None:
        """One event of the controller; what it does not know is ignored."""
        if kind == EV_ABS:
            if code in (ABS_X, ABS_Y):
                self._raw[code] = value
                self._to_x, self._to_y = self._places()
        elif kind == EV_KEY:
            bit = self._bits.get(code)
            if bit is not None:
                self._buttons = self._buttons | bit if value else self._buttons & ~bit
            elif code == self._dead_man_code:
                self._dead_man = bool(value)
        elif kind == EV_SYN and code == SYN_DROPPED:
            self.needs_state = True

    def handle_state(self, x: int, y: int, pressed: frozenset[int]) -> None:
        """What the kernel says of the axes and of the buttons that are pressed now."""
        self.needs_state = False
        self._raw = [x, y]
        self._to_x, self._to_y = self._places()
        self._buttons = sum(bit for code, bit in self._bits.items() if code in pressed)
        if self._dead_man_code is not None:
            self._dead_man = self._dead_man_code in pressed

    def handle_zero(self, x_m: float, y_m: float) -> None:
        """What reads (x_m, y_m) now reads 0 from now on."""
        self._zero_x += x_m
        self._zero_y += y_m

    def handle_gone(self) -> None:
        """It was unplugged."""
        self.present = False

    def reading(self) -> Reading:
        """Where the filter is now, and the buttons."""
        return Reading(
            self._x - self._zero_x,
            self._y - self._zero_y,
            self._vx,
            self._vy,
            self._buttons,
            self._dead_man,
            None,
            self.present,
        )

    def advance(self, dt_ns: int) -> None:
        """`dt_ns` pass."""
        if dt_ns <= 0:
            return
        left_s = dt_ns / NS_PER_S
        while left_s > 0.0:
            dt_s = min(left_s, _CYCLE_S)
            self._vx = _velocity(self._vx, self._to_x - self._x, dt_s)
            self._vy = _velocity(self._vy, self._to_y - self._y, dt_s)
            self._x += self._vx * dt_s
            self._y += self._vy * dt_s
            left_s -= dt_s

    def _places(self) -> tuple[float, float]:
        x, y = (_share(axis, raw) for axis, raw in zip(self._axes, self._raw, strict=True))
        # Down is positive in the kernel, up in the workspace.
        return x * HALF_WIDTH_M, -y * HALF_HEIGHT_M


def _velocity(velocity: float, way: float, dt_s: float) -> float:
    """The velocity (m/s) after `dt_s` of what still has `way` (m) to go, and moves so fast now."""
    # Below this the time constant brakes less than the limit allows, beyond it the limit does.
    near = _BRAKING_M_S2 * TAU_S * TAU_S
    size = abs(way)
    wanted = size / TAU_S if size <= near else sqrt(_BRAKING_M_S2 * (2.0 * size - near))
    wanted = min(wanted, SPEED_M_S)
    change = (wanted if way > 0.0 else -wanted) - velocity
    most = ACCELERATION_M_S2 * dt_s
    return velocity + max(-most, min(most, change))


def _share(axis: Axis, raw: int) -> float:
    """`raw` as a share of the travel, -1 to 1, without the flat part around the middle."""
    half = (axis.most - axis.least) / 2
    if half <= 0:
        # It says no range, as a device of uinput may: it cannot tell where it is.
        return 0.0
    off = raw - (axis.most + axis.least) / 2
    flat = min(axis.flat, half / 2)
    if abs(off) <= flat:
        return 0.0
    share = (abs(off) - flat) / (half - flat)
    return min(share, 1.0) if off > 0 else -min(share, 1.0)


#: Changes are so far apart at least, and an effect is never older: well below `RUMBLE_NS`.
_APART_NS = 50 * NS_PER_MS
_ANEW_NS = 500 * NS_PER_MS
#: An effect plays for so long at most: a process that is killed leaves no pad shaking.
RUMBLE_NS = 1000 * NS_PER_MS


class RumbleMeter:
    """How strongly to shake for a force: changes of a tenth, and not more often than a pad hears.

    `handle_force` gives the magnitude to set, 0 to 65535, or None when the old one will do. An
    effect ends by itself: as long as there is one, it is set anew every half second.
    """

    def __init__(self, full_n: float) -> None:
        self._full_n = full_n
        self._shown = 0.0
        self._age_ns = _ANEW_NS

    def handle_force(self, force_n: float, dt_ns: int) -> int | None:
        """`force_n` (N, >= 0) is to be felt; `dt_ns` have passed since the last call."""
        self._age_ns += dt_ns
        share = min(force_n / self._full_n, 1.0)
        if share == 0.0:
            # Off is off at once.
            if self._shown == 0.0:
                return None
        else:
            changed = abs(share - self._shown) >= 0.1
            ending = self._shown > 0.0 and self._age_ns >= _ANEW_NS
            if not ending and not (changed and self._age_ns >= _APART_NS):
                return None
        self._shown = share
        self._age_ns = 0
        return round(share * 0xFFFF)
