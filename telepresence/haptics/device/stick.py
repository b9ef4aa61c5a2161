"""A game controller's stick and buttons: a core that receives events as Linux delivers them.

Codes and meanings follow the kernel's `linux/input-event-codes.h` and the "Linux Gamepad
Specification" (Documentation/input/gamepad.rst).

A stick reports 8 to 16 bits at 125 to 1000 Hz, and springs back within a few milliseconds when
released. Such a jump would hit the robot hard and break the bilateral controller's bound for the
next cycle. A filter with a hand's speed and acceleration therefore follows the stick.
"""

from math import sqrt
from typing import NamedTuple

from kontur_av.clock import NS_PER_MS, NS_PER_S
from telepresence.haptics.device.device import JoystickFacts, JoystickReading

EV_SYN, EV_KEY, EV_ABS, EV_FF = 0x00, 0x01, 0x03, 0x15
SYN_DROPPED = 3
ABS_X, ABS_Y = 0x00, 0x01
FF_RUMBLE = 0x50
#: Gamepad: south, east, west, north. Joystick: the buttons under the thumb.
_PAD_BUTTONS = (0x130, 0x131, 0x134, 0x133)
_PAD_DEAD_MAN = 0x136  # BTN_TL, the left shoulder
_STICK_BUTTONS = (0x121, 0x122, 0x123, 0x124)
_STICK_DEAD_MAN = 0x120  # BTN_TRIGGER

#: Workspace that the stick's full travel is mapped to.
HALF_WIDTH_M, HALF_HEIGHT_M = 0.1, 0.08
#: Time constant of the last part of the filter's travel. Chosen: too short to be noticed, longer
#: than the interval between two reports of a controller.
TAU_S = 0.015
#: Per axis. Both axes together stay below `JoystickControllerModel.acceleration_m_s2`.
ACCELERATION_M_S2 = 100.0
SPEED_M_S = 2.0
#: Deceleration for planning; it leaves room for rounding within a cycle, so nothing overshoots.
_BRAKING_M_S2 = 0.8 * ACCELERATION_M_S2
_CYCLE_S = NS_PER_MS / NS_PER_S


class Axis(NamedTuple):
    """The kernel's description of an axis: its range, and the flat part around the middle."""

    value: int
    least: int
    most: int
    flat: int = 0


def dead_man_of(keys: frozenset[int]) -> int | None:
    """Return the code of the dead-man button of a controller with these keys.

    The left shoulder or the trigger, else its first button; None without buttons.
    """
    usual = _PAD_DEAD_MAN if _PAD_BUTTONS[0] in keys else _STICK_DEAD_MAN
    return usual if usual in keys else min(keys, default=None)


class Stick:
    """The left stick and the buttons of one controller, from its events.

    axes: the kernel's description of ABS_X and ABS_Y. keys: codes of all buttons.

    Full travel is ±0.1 m along x and ±0.08 m along y, with +y up. The dead-man button is the left
    shoulder (on a joystick: the trigger). A controller without one counts as always held.

    needs_state: events were lost; query the kernel and call `handle_state`.
    """

    def __init__(
        self, name: str, axes: tuple[Axis, Axis], keys: frozenset[int], *, rumble: bool = False
    ) -> None:
        buttons = _PAD_BUTTONS if _PAD_BUTTONS[0] in keys else _STICK_BUTTONS
        self._dead_man_code = dead_man_of(keys)
        kept = [code for code in buttons if code in keys and code != self._dead_man_code]
        self._bits = {code: 1 << index for index, code in enumerate(kept)}
        self.facts = JoystickFacts(
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
        self._dead_man = False
        self._to_x, self._to_y = self._x, self._y = self._places()
        self._vx = self._vy = 0.0
        self._zero_x = self._zero_y = 0.0

    def handle_event(self, kind: int, code: int, value: int) -> None:
        """Take one event of the controller; unknown events are ignored."""
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
        """Set the axes' raw values and the codes of the pressed buttons, as the kernel has them."""
        self.needs_state = False
        self._raw = [x, y]
        self._to_x, self._to_y = self._places()
        self._buttons = sum(bit for code, bit in self._bits.items() if code in pressed)
        self._dead_man = self._dead_man_code in pressed

    def handle_zero(self, x_m: float, y_m: float) -> None:
        """Make the present position (x_m, y_m) the middle."""
        self._zero_x += x_m
        self._zero_y += y_m

    def handle_gone(self) -> None:
        """The controller was unplugged."""
        self.present = False

    def reading(self) -> JoystickReading:
        """Return the filtered position and the buttons."""
        return JoystickReading(
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
        """Advance the filter by `dt_ns`."""
        if dt_ns <= 0:
            return
        left_s = dt_ns / NS_PER_S
        while left_s > 0.0:
            dt_s = min(left_s, _CYCLE_S)
            self._vx = velocity_towards(self._vx, self._to_x - self._x, dt_s, TAU_S)
            self._vy = velocity_towards(self._vy, self._to_y - self._y, dt_s, TAU_S)
            self._x += self._vx * dt_s
            self._y += self._vy * dt_s
            left_s -= dt_s

    def _places(self) -> tuple[float, float]:
        x, y = (_share(axis, raw) for axis, raw in zip(self._axes, self._raw, strict=True))
        # The kernel counts down as positive, the workspace up.
        return x * HALF_WIDTH_M, -y * HALF_HEIGHT_M


def velocity_towards(velocity: float, way: float, dt_s: float, tau_s: float) -> float:
    """Return the velocity (m/s) after `dt_s`, with `way` (m) left to the target.

    It is that of a hand: at most `SPEED_M_S`, with at most `ACCELERATION_M_S2`.
    tau_s: time constant of the last part of the way, at least `dt_s`.
    """
    # Within `near`, the time constant brakes less than the limit allows; beyond, the limit rules.
    near = _BRAKING_M_S2 * tau_s * tau_s
    size = abs(way)
    wanted = size / tau_s if size <= near else sqrt(_BRAKING_M_S2 * (2.0 * size - near))
    wanted = min(wanted, SPEED_M_S)
    change = (wanted if way > 0.0 else -wanted) - velocity
    most = ACCELERATION_M_S2 * dt_s
    return velocity + max(-most, min(most, change))


def _share(axis: Axis, raw: int) -> float:
    """Map `raw` to the travel, -1 to 1, without the flat part around the middle."""
    half = (axis.most - axis.least) / 2
    if half <= 0:
        # An axis without a range, as on some uinput devices, has no known position.
        return 0.0
    off = raw - (axis.most + axis.least) / 2
    flat = min(axis.flat, half / 2)
    if abs(off) <= flat:
        return 0.0
    share = (abs(off) - flat) / (half - flat)
    return min(share, 1.0) if off > 0 else -min(share, 1.0)


#: Shortest interval between changes, and longest age of an effect; well below `RUMBLE_NS`.
_APART_NS = 50 * NS_PER_MS
_ANEW_NS = 500 * NS_PER_MS
#: Longest play time of an effect: if the process is killed, the rumble ends soon.
RUMBLE_NS = 1000 * NS_PER_MS


class RumbleMeter:
    """Rumble strength for a force: changes of at least a tenth, at a rate that controllers accept.

    `handle_force` returns the magnitude to set, 0 to 65535, or None to keep the present one. An
    effect ends by itself, so it is renewed every half second.
    """

    def __init__(self, full_n: float) -> None:
        self._full_n = full_n
        self._shown = 0.0
        self._age_ns = _ANEW_NS

    def handle_force(self, force_n: float, dt_ns: int) -> int | None:
        """Take the force (N, >= 0) to show; `dt_ns` have passed since the last call."""
        self._age_ns += dt_ns
        share = min(force_n / self._full_n, 1.0)
        if share == 0.0:
            # Switch off at once.
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
