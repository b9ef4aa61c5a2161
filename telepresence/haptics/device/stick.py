"""A game controller's or a puck's axes and buttons: a core that gets events as Linux has them.

Codes and meanings follow the kernel's `linux/input-event-codes.h` and the "Linux Gamepad
Specification" (Documentation/input/gamepad.rst).

A puck (SpaceMouse) has six axes that spring back, so each deflection is a speed: an axis goes on
while the dead-man button is held, and stays otherwise. Older kernels tell its deflections as
relative motions, again and again, but never a zero.

A stick springs back within a few milliseconds when released. Such a jump would break the bilateral
controller's bound for the next cycle. A filter with a hand's speed and acceleration follows it.
"""

from collections.abc import Collection, Mapping, Sequence
from math import sqrt
from typing import NamedTuple

from kontur_av.clock import NS_PER_MS, NS_PER_S
from telepresence.haptics.axes import (
    AXIS_NAMES,
    AxisCapabilities,
    AxisReading,
    built_in_axis,
)
from telepresence.haptics.device.device import JoystickCapabilities, JoystickReading
from telepresence.haptics.device.stick_map import Control, MappedAxis, StickMap, control_name

EV_SYN, EV_KEY, EV_REL, EV_ABS, EV_FF = 0x00, 0x01, 0x02, 0x03, 0x15
SYN_DROPPED = 3
ABS_X, ABS_Y = 0x00, 0x01
_ABS_Z, _ABS_RX, _ABS_RY, _ABS_RZ, _ABS_THROTTLE = 0x02, 0x03, 0x04, 0x05, 0x06
_ABS_HAT0X, _ABS_HAT0Y = 0x10, 0x11
_BTN_TL2, _BTN_TR2 = 0x138, 0x139
FF_RUMBLE = 0x50
#: Gamepad: south, east, west, north. Joystick: the buttons under the thumb.
_PAD_BUTTONS = (0x130, 0x131, 0x134, 0x133)
_PAD_DEAD_MAN = 0x136  # BTN_TL, the left shoulder
_STICK_BUTTONS = (0x121, 0x122, 0x123, 0x124)
_STICK_DEAD_MAN = 0x120  # BTN_TRIGGER

#: A puck's buttons, BTN_0 and on. x, y, z and their rotations have the codes 0 to 5, as REL_ and as
#: ABS_: to the right, towards the user and down.
_PUCK_BUTTONS = range(0x100, 0x110)
PUCK_CODES = frozenset(range(6))
#: The deflection of a puck whose kernel tells none, and the part around the middle that counts as
#: rest. Chosen; pucks tell up to 350 to 500.
_PUCK_MOST, _PUCK_FLAT = 350, 12
#: With so many buttons, the last two of a puck close and open the gripper.
_MANY_BUTTONS = 4
#: Without a relative motion for this long, that axis is in its middle. Pucks tell one every 16 ms.
_PUCK_REST_NS = 60 * NS_PER_MS

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
#: The hat, or a trigger pulled fully, leads over half of a range in this time. Chosen.
_HALF_RANGE_NS = NS_PER_S


class Axis(NamedTuple):
    """The kernel's description of an axis: its range, and the flat part around the middle."""

    value: int
    least: int
    most: int
    flat: int = 0


def is_puck(axes: Collection[int], keys: Collection[int]) -> bool:
    """Whether a device with these relative or absolute axes and keys is a puck."""
    return {*axes} >= PUCK_CODES and any(key in _PUCK_BUTTONS for key in keys)


def puck_axes() -> dict[int, Axis]:
    """Return the axes of a puck whose kernel tells relative motions."""
    return {code: Axis(0, -_PUCK_MOST, _PUCK_MOST, _PUCK_FLAT) for code in sorted(PUCK_CODES)}


def dead_man_of(keys: frozenset[int]) -> int | None:
    """Return the dead-man button: left shoulder or trigger, else the first of `keys`, if any."""
    usual = _PAD_DEAD_MAN if _PAD_BUTTONS[0] in keys else _STICK_DEAD_MAN
    return usual if usual in keys else min(keys, default=None)


class _Lead(NamedTuple):
    """What leads one axis.

    code: the axis of the controller, or with `less` the right one of two triggers, of which the
    left one counts less. sign: -1 where the kernel counts against the axis; or another scale.
    stays: a deflection is a speed, so that the axis stays when released; else it is a place.
    dead_zone: the part of the deflection that counts as rest, beside what the kernel says.
    """

    code: int
    sign: float = 1.0
    less: int | None = None
    stays: bool = False
    dead_zone: float = 0.0

    @classmethod
    def of(cls, row: MappedAxis) -> "_Lead":
        code, *less = row.controls
        return cls(code, row.scale, less[0] if less else None, row.mode == "rate", row.dead_zone)

    def words(self, keys: Collection[int]) -> str:
        codes = [self.code] if self.less is None else [self.code, self.less]
        names = [control_name(code, button=code in keys) for code in codes]
        scale = f", scale {self.sign:g}" if self.sign != 1.0 else ""
        zone = f", dead zone {self.dead_zone:g}" if self.dead_zone else ""
        return f"{' and '.join(names)}{scale}{zone}, {'rate' if self.stays else 'position'}"


def _leads(axes: Collection[int], keys: Collection[int]) -> dict[str, _Lead]:
    """Return what leads each axis that a controller with these axes and keys has."""
    if is_puck(axes, keys):
        return _puck_leads(keys)
    leads: dict[str, _Lead] = {
        "x": _Lead(ABS_X),
        "y": _Lead(ABS_Y, -1.0),
        "roll": _Lead(_ABS_HAT0X, stays=True),
        "pitch": _Lead(_ABS_HAT0Y, -1.0, stays=True),
    }
    if _PAD_BUTTONS[0] not in keys:
        # A joystick has a throttle, and is twisted.
        throttle = _ABS_THROTTLE if _ABS_THROTTLE in axes else _ABS_Z
        leads |= {"z": _Lead(throttle, -1.0), "yaw": _Lead(_ABS_RZ)}
    elif {_ABS_RX, _ABS_RY} <= set(axes):
        leads |= {"z": _Lead(_ABS_RY, -1.0), "yaw": _Lead(_ABS_RX)}
        leads["gripper"] = _Lead(_ABS_RZ, less=_ABS_Z, stays=True)
    else:
        # The right stick of older pads; their triggers are buttons.
        leads |= {"z": _Lead(_ABS_RZ, -1.0), "yaw": _Lead(_ABS_Z)}
    known = {
        name: lead for name, lead in leads.items() if {lead.code, lead.less} - {None} <= {*axes}
    }
    if _PAD_BUTTONS[0] in keys and "gripper" not in known and {_BTN_TL2, _BTN_TR2} <= set(keys):
        known["gripper"] = _Lead(_BTN_TR2, less=_BTN_TL2, stays=True)
    return known


def _puck_leads(keys: Collection[int]) -> dict[str, _Lead]:
    leads = {
        "x": _Lead(ABS_X, stays=True),
        "y": _Lead(ABS_Y, -1.0, stays=True),
        "z": _Lead(_ABS_Z, -1.0, stays=True),
        "roll": _Lead(_ABS_RY, -1.0, stays=True),
        "pitch": _Lead(_ABS_RX, -1.0, stays=True),
        "yaw": _Lead(_ABS_RZ, stays=True),
    }
    own = sorted(key for key in keys if key in _PUCK_BUTTONS)
    if len(own) >= _MANY_BUTTONS:
        leads["gripper"] = _Lead(own[-1], less=own[-2], stays=True)
    return leads


def stick_axes(axes: Collection[int], keys: Collection[int]) -> tuple[str, ...]:
    """Return the axes behind x and y of a controller with these axes and keys."""
    known = _leads(axes, keys)
    return tuple(name for name in AXIS_NAMES if name in known)


class FollowedAxis:
    """Follows a place with a hand's speed and acceleration, as `velocity_towards` has them."""

    def __init__(self, tau_s: float, position_m: float = 0.0, speed_m_s: float = SPEED_M_S) -> None:
        self.position, self.speed = position_m, 0.0
        self._tau_s, self._most_m_s = tau_s, speed_m_s

    def advance(self, to_m: float, dt_ns: int) -> None:
        """`dt_ns` pass, on the way to `to_m`."""
        left_s = dt_ns / NS_PER_S
        while left_s > 0.0:
            dt_s = min(left_s, _CYCLE_S)
            self.speed = velocity_towards(
                self.speed, to_m - self.position, dt_s, self._tau_s, self._most_m_s
            )
            self.position += self.speed * dt_s
            left_s -= dt_s


class _LedAxis:
    """One axis. lead: None: nothing moves it. zero_m: its middle. Lengths are at its lever."""

    def __init__(self, lead: _Lead | None, half_m: float, most_m_s: float = SPEED_M_S) -> None:
        self.lead, self._half_m = lead, half_m
        self.zero_m = self._to_m = 0.0
        self.followed = FollowedAxis(TAU_S, speed_m_s=most_m_s)

    def begin(self, share: float) -> None:
        """Stand where the deflection says, if it is a place."""
        if self.lead is not None and not self.lead.stays:
            self._to_m = self.followed.position = share * self._half_m

    def advance(self, share: float, dt_ns: int, *, held: bool) -> None:
        """Take the deflection; `dt_ns` pass. held: the dead-man button is pressed."""
        half_m, lead = self._half_m, self.lead
        if lead is not None and not lead.stays:
            self._to_m = max(-1.0, min(1.0, share)) * half_m
        elif held:
            to_m = self._to_m - self.zero_m + share * half_m * dt_ns / _HALF_RANGE_NS
            self._to_m = self.zero_m + max(-half_m, min(half_m, to_m))
        self.followed.advance(self._to_m, dt_ns)


class _LedMore(_LedAxis):
    """One more axis."""

    def __init__(self, capabilities: AxisCapabilities, lead: _Lead) -> None:
        lever_m = capabilities.lever_m
        super().__init__(lead, capabilities.half_range * lever_m, capabilities.speed * lever_m)
        self.capabilities = capabilities

    def reading(self) -> AxisReading:
        lever_m, followed = self.capabilities.lever_m, self.followed
        return AxisReading(followed.position / lever_m, followed.speed / lever_m)


class Stick:
    """The sticks, triggers and buttons of one controller, from its events.

    axes: the kernel's description of each, by its code; ABS_X and ABS_Y are among them. keys: codes
    of all buttons. more: those axes behind x and y that the facts shall have, as far as the
    controller has them (`stick_axes`). mapping: which control moves what; ConfigError for one that
    the controller lacks. None: the usual.

    Full travel is ±0.1 m along x and ±0.08 m along y, with +y up. The dead-man button is the left
    shoulder (on a joystick: the trigger; on a puck: the first button).

    needs_state: events were lost; query the kernel and call `handle_state`. mapped: what its axes
    and buttons do, a line each.
    """

    def __init__(
        self,
        name: str,
        axes: Mapping[int, Axis],
        keys: frozenset[int],
        *,
        rumble: bool = False,
        more: Sequence[str] = (),
        mapping: StickMap | None = None,
    ) -> None:
        self._dead_man_code: int | None = None
        self._stop_code: int | None = None
        self._hand_over_code: int | None = None
        if mapping is None:
            leads, kept = self._usual(axes, keys)
            # A robot's own axes get the leads that no other has.
            free = [name for name in ("yaw", "z", "roll", "pitch") if name in {*leads} - {*more}]
            own = [name for name in more if name not in AXIS_NAMES]
            leads |= {name: leads[other] for name, other in zip(own, free, strict=False)}
        else:
            mapping.check(axes, keys)
            leads = {name: _Lead.of(row) for name, row in mapping.axis.items()}
            buttons = mapping.buttons
            self._dead_man_code = Control(buttons.dead_man)
            if buttons.stop is not None:
                self._stop_code = Control(buttons.stop)
            if buttons.hand_over is not None:
                self._hand_over_code = Control(buttons.hand_over)
            kept = [int(Control(name)) for name in buttons.panel]
        #: Of a puck: for how long each relative axis has been quiet.
        self._quiet_ns: dict[int, int] = {}
        self._bits = {code: 1 << index for index, code in enumerate(kept)}
        self._more = [_LedMore(built_in_axis(one), leads[one]) for one in more if one in leads]
        self.mapped = [f"{name}: {lead.words(keys)}" for name, lead in leads.items()]
        deeds: dict[str, int | None] = {"dead-man": self._dead_man_code, "stop": self._stop_code}
        deeds |= {"hand-over": self._hand_over_code}
        deeds |= {f"button {number}": code for number, code in enumerate(kept, 1)}
        self.mapped += [
            f"{deed}: {control_name(code, button=True)}"
            for deed, code in deeds.items()
            if code is not None
        ]
        self.capabilities = JoystickCapabilities(
            name=name,
            half_width_m=HALF_WIDTH_M,
            half_height_m=HALF_HEIGHT_M,
            buttons=len(self._bits),
            rumble=rumble,
            more=tuple(axis.capabilities for axis in self._more),
        )
        self.needs_state = False
        self.present = True
        self._axes = axes
        self._raw = {code: axis.value for code, axis in axes.items()}
        self._pressed: set[int] = set()
        self._x = _LedAxis(leads.get("x"), HALF_WIDTH_M)
        self._y = _LedAxis(leads.get("y"), HALF_HEIGHT_M)
        for axis in (self._x, self._y):
            axis.begin(self._deflection(axis.lead))

    def _usual(
        self, axes: Mapping[int, Axis], keys: frozenset[int]
    ) -> tuple[dict[str, _Lead], list[int]]:
        """Return what leads each axis, and the codes of the buttons, without a mapping."""
        buttons: Sequence[int] = _PAD_BUTTONS if _PAD_BUTTONS[0] in keys else _STICK_BUTTONS
        self._dead_man_code = dead_man_of(keys)
        leads, used = _leads(axes, keys), {self._dead_man_code}
        if is_puck(axes, keys):
            buttons = _PUCK_BUTTONS
            pairs = (lead for lead in leads.values() if lead.less is not None)
            used |= {code for lead in pairs for code in (lead.code, lead.less)}
        return leads, [code for code in buttons if code in keys and code not in used][:4]

    def handle_event(self, kind: int, code: int, value: int) -> None:
        """Take one event of the controller; unknown events are ignored."""
        if kind == EV_REL and code in self._raw:
            self._raw[code], self._quiet_ns[code] = value, 0
        elif kind == EV_ABS:
            if code in self._raw:
                self._raw[code] = value
        elif kind == EV_KEY:
            (self._pressed.add if value else self._pressed.discard)(code)
        elif kind == EV_SYN and code == SYN_DROPPED:
            self.needs_state = True

    def handle_state(self, raw: Mapping[int, int], pressed: Collection[int]) -> None:
        """Set the axes' raw values and the codes of the pressed buttons, as the kernel has them."""
        self.needs_state = False
        self._raw.update(raw)
        self._pressed = set(pressed)

    def handle_zero(self, x_m: float, y_m: float) -> None:
        """Make the present position (x_m, y_m) the middle."""
        self._x.zero_m += x_m
        self._y.zero_m += y_m

    def handle_gone(self) -> None:
        """The controller was unplugged."""
        self.present = False

    @property
    def codes(self) -> Collection[int]:
        """Codes of the axes that `handle_state` wants."""
        return self._raw.keys()

    def reading(self) -> JoystickReading:
        """Return the filtered position and the buttons."""
        x, y, pressed = self._x.followed, self._y.followed, self._pressed
        return JoystickReading(
            x.position - self._x.zero_m,
            y.position - self._y.zero_m,
            x.speed,
            y.speed,
            sum(bit for code, bit in self._bits.items() if code in pressed),
            self._dead_man_code in pressed,
            None,
            self.present,
            stop=self._stop_code in pressed,
            hand_over=self._hand_over_code in pressed,
        )

    def more_readings(self) -> list[AxisReading]:
        """Return the filtered places behind x and y."""
        return [axis.reading() for axis in self._more]

    def advance(self, dt_ns: int) -> None:
        """Advance the filter by `dt_ns`."""
        for code, quiet_ns in self._quiet_ns.items():
            self._quiet_ns[code] = quiet_ns + dt_ns
            if quiet_ns >= _PUCK_REST_NS:
                self._raw[code] = 0
        held = self._dead_man_code in self._pressed
        for axis in (self._x, self._y, *self._more):
            axis.advance(self._deflection(axis.lead), dt_ns, held=held)

    def _deflection(self, lead: _Lead | None) -> float:
        """Return from -1 to 1, times the scale, how far what leads an axis is deflected."""
        if lead is None:
            return 0.0
        if lead.less is None:
            share = _share(self._axes[lead.code], self._raw[lead.code])
        else:
            share = self._pulled(lead.code) - self._pulled(lead.less)
        if lead.dead_zone:
            beyond = max(abs(share) - lead.dead_zone, 0.0) / (1.0 - lead.dead_zone)
            share = beyond if share > 0.0 else -beyond
        return lead.sign * share

    def _pulled(self, code: int) -> float:
        """Return from 0 to 1 how far a trigger is pulled."""
        axis = self._axes.get(code)
        if axis is None:
            return float(code in self._pressed)
        least = axis.least + max(axis.flat, 0)
        return max(0.0, min(1.0, (self._raw[code] - least) / max(axis.most - least, 1)))


def velocity_towards(
    velocity: float, way: float, dt_s: float, tau_s: float, most_m_s: float = SPEED_M_S
) -> float:
    """Return the velocity (m/s) after `dt_s`, with `way` (m) left to the target.

    It is that of a hand: at most `most_m_s`, with at most `ACCELERATION_M_S2`.
    tau_s: time constant of the last part of the way, at least `dt_s`.
    """
    # Within `near`, the time constant brakes less than the limit allows; beyond, the limit rules.
    near = _BRAKING_M_S2 * tau_s * tau_s
    size = abs(way)
    wanted = size / tau_s if size <= near else sqrt(_BRAKING_M_S2 * (2.0 * size - near))
    wanted = min(wanted, most_m_s)
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
