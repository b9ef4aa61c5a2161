"""Which control of a device moves which axis: what a joystick map can say. A core.

Names of controls are those of the kernel's `linux/input-event-codes.h`; of a browser's gamepad,
those that have the same place in the W3C's "Standard Gamepad".
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from re import fullmatch
from typing import Final, Literal

import msgspec

from kontur_av.errors import ConfigError, refused
from telepresence.haptics.axes import AXIS_NAMES, AxisName, AxisSettings

_FIRST_AXES = ("X", "Y", "Z", "RX", "RY", "RZ", "THROTTLE", "RUDDER", "WHEEL", "GAS", "BRAKE")
_HATS = [f"HAT{number}{way}" for number in range(4) for way in "XY"]
#: By first code: names one after the other.
_BUTTONS: Mapping[int, str] = {
    0x100: "0 1 2 3 4 5 6 7 8 9",
    0x120: "TRIGGER THUMB THUMB2 TOP TOP2 PINKIE BASE BASE2 BASE3 BASE4 BASE5 BASE6",
    0x130: "SOUTH EAST C NORTH WEST Z TL TR TL2 TR2 SELECT START MODE THUMBL THUMBR",
    0x220: "DPAD_UP DPAD_DOWN DPAD_LEFT DPAD_RIGHT",
}
_AXIS_CODES = {name: code for code, name in chain(enumerate(_FIRST_AXES), enumerate(_HATS, 0x10))}
_BUTTON_CODES = {
    name: code
    for first, names in _BUTTONS.items()
    for code, name in enumerate(names.split(), first)
}
_OTHER_NAMES = {"A": 0x130, "B": 0x131, "X": 0x133, "Y": 0x134}
_NAMES = {("ABS", code): f"ABS_{name}" for name, code in _AXIS_CODES.items()} | {
    ("BTN", code): f"BTN_{name}" for name, code in _BUTTON_CODES.items()
}
#: A code that has no name here.
_BY_NUMBER: Final = "(ABS|REL|BTN)_(0x[0-9a-f]{1,3})"
#: The panel's buttons.
_MOST_BUTTONS = 4
_MOST_SCALE, _MOST_DEAD_ZONE = 10.0, 0.9
_CONTROL = 'a control in quotes, like "ABS_RX", or two, like ["BTN_TR", "BTN_TL"]: up and down'


class Control(int):
    """A control by its code. button: it is one, not an axis."""

    button: bool

    def __new__(cls, name: str) -> "Control":
        kind, _, rest = name.partition("_")
        code = (_BUTTON_CODES | _OTHER_NAMES).get(rest) if kind == "BTN" else _AXIS_CODES.get(rest)
        if kind not in ("ABS", "REL", "BTN") or code is None:
            if (match := fullmatch(_BY_NUMBER, name)) is None:
                raise ConfigError(
                    f"{name!r} is no control: take a name of `kontur-av joystick check`, such as "
                    "ABS_RX or BTN_TL, or a number, such as BTN_0x2c0"
                )
            code = int(match[2], 16)
        control = super().__new__(cls, code)
        control.button = kind == "BTN"
        return control


def control_name(code: int, *, button: bool) -> str:
    """Return the kernel's name of a control."""
    kind = "BTN" if button else "ABS"
    return _NAMES.get((kind, code), f"{kind}_{code:#x}")


@dataclass(frozen=True, kw_only=True, slots=True)
class MappedAxis:
    """What moves an axis; a table `[axis.NAME]` of the file.

    control: an axis, such as "ABS_RX"; or two controls, of which the first counts up and the
    second down: triggers or buttons.
    scale: of the full deflection; below 0 it is turned. The kernel counts right and down as
    positive.
    dead_zone: the share of the deflection around the middle that counts as rest.
    mode: `position`: the deflection is a share of half the axis' range. `rate`: it is a speed, half
    the range in a second, while the dead-man button is held.
    """

    control: str | tuple[str, str] = field(metadata={"like": _CONTROL})
    scale: float = 1.0
    dead_zone: float = 0.0
    mode: Literal["position", "rate"] = "position"

    def check(self) -> None:
        """Raise ConfigError for what cannot be."""
        controls = self.controls
        if len(controls) == 1 and controls[0].button:
            raise ConfigError(f"control {self.control} is a button: give two, up and down")
        if not 0.0 < abs(self.scale) <= _MOST_SCALE:
            raise ConfigError(f"scale is {self.scale:g}: take up to {_MOST_SCALE:g}, but not 0")
        if not 0.0 <= self.dead_zone <= _MOST_DEAD_ZONE:
            raise ConfigError(f"dead_zone is {self.dead_zone:g}: take 0 to {_MOST_DEAD_ZONE}")

    @property
    def controls(self) -> tuple[Control, ...]:
        """The one, or those that count up and down."""
        names = (self.control,) if isinstance(self.control, str) else self.control
        return tuple(map(Control, names))


@dataclass(frozen=True, kw_only=True, slots=True)
class MappedButtons:
    """The buttons; the table `[buttons]` of the file. ConfigError for what cannot be.

    dead_man: nothing moves without it. stop: the emergency stop. hand_over: to a policy that is
    there, or back from it. panel: the panel's buttons, the first one first.
    """

    dead_man: str
    stop: str | None = None
    hand_over: str | None = None
    panel: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in self.names:
            if not Control(name).button:
                raise ConfigError(f"buttons: {name} is no button")
        if len(self.panel) > _MOST_BUTTONS:
            raise ConfigError(f"buttons.panel has {len(self.panel)}: {_MOST_BUTTONS} are the most")

    @property
    def names(self) -> tuple[str, ...]:
        single = (self.dead_man, self.stop, self.hand_over)
        return (*(name for name in single if name is not None), *self.panel)


@dataclass(frozen=True, kw_only=True, slots=True)
class StickMap:
    """A device's mapping. ConfigError for what cannot be."""

    axis: Mapping[str, MappedAxis]
    buttons: MappedButtons

    def __post_init__(self) -> None:
        for name, row in self.axis.items():
            with refused(f"axis.{name}", ConfigError):
                row.check()
            if name not in ("x", "y", *AXIS_NAMES):
                AxisName(name, AxisSettings(kind="linear"))
        moved = [
            (control.button, control) for row in self.axis.values() for control in row.controls
        ]
        uses = Counter(moved) + Counter((True, Control(name)) for name in self.buttons.names)
        for (button, code), count in uses.items():
            if count > 1:
                name = control_name(code, button=button)
                raise ConfigError(f"{name} is used {count} times: give each use its own control")

    def check(self, axes: Mapping[int, object], keys: frozenset[int]) -> None:
        """Raise ConfigError for a control that a device with these axes and keys lacks."""
        rows = [(f"axis.{name}", one) for name, row in self.axis.items() for one in row.controls]
        rows += [("buttons", Control(name)) for name in self.buttons.names]
        for where, control in rows:
            if control not in (keys if control.button else axes):
                has = [control_name(code, button=False) for code in sorted(axes)]
                has += [control_name(code, button=True) for code in sorted(keys)]
                name = control_name(control, button=control.button)
                raise ConfigError(f"{where}: there is no {name}; it has {', '.join(has)}")


#: By control: the axis or the button of a browser's standard gamepad; a hat's and a trigger's are
#: buttons there: those that count up and down.
_PAD_AXES = {"ABS_X": 0, "ABS_Y": 1, "ABS_RX": 2, "ABS_RY": 3}
_PAD_NAMES = (
    *("SOUTH", "EAST", "WEST", "NORTH", "TL", "TR", "TL2", "TR2", "SELECT", "START"),
    *("THUMBL", "THUMBR", "DPAD_UP", "DPAD_DOWN", "DPAD_LEFT", "DPAD_RIGHT", "MODE"),
)
_PAD_BUTTONS = {f"BTN_{name}": index for index, name in enumerate(_PAD_NAMES)}
_PAD_PAIRS = {"ABS_HAT0X": (15, 14), "ABS_HAT0Y": (13, 12)}
_PAD_TRIGGERS = {"ABS_Z": 6, "ABS_RZ": 7}
NO_CONTROL: Final = -1


class PadAxis(msgspec.Struct, frozen=True, kw_only=True):
    """What moves an axis on a browser's standard gamepad: an axis, or two buttons, up and down.

    -1 stands for none.
    """

    name: str
    axis: int
    up: int
    down: int
    scale: float
    dead_zone: float
    rate: bool


class PadControls(msgspec.Struct, frozen=True, kw_only=True):
    """The mapping of a browser's standard gamepad. dead_man: any of these buttons will do."""

    axes: tuple[PadAxis, ...]
    dead_man: tuple[int, ...]
    stop: int
    hand_over: int
    panel: tuple[int, ...]


def pad_controls(mapping: StickMap, axes: Sequence[str]) -> PadControls:
    """Return what moves the axes of a page; ConfigError for a control that no standard gamepad has.

    axes: those behind x and y; the page's other controls move those that the mapping lacks.
    """
    buttons = mapping.buttons
    return PadControls(
        axes=tuple(
            _pad_axis(name, row) for name, row in mapping.axis.items() if name in ("x", "y", *axes)
        ),
        dead_man=(_pad_button(buttons.dead_man),),
        stop=_pad_button(buttons.stop),
        hand_over=_pad_button(buttons.hand_over),
        panel=tuple(map(_pad_button, buttons.panel)),
    )


def _pad_axis(name: str, row: MappedAxis) -> PadAxis:
    axis, up, down = _pad_control(name, row)
    rate = row.mode == "rate"
    return PadAxis(
        name=name,
        axis=axis,
        up=up,
        down=down,
        scale=row.scale,
        dead_zone=row.dead_zone,
        rate=rate,
    )


def _pad_control(name: str, row: MappedAxis) -> tuple[int, int, int]:
    names = [control_name(one, button=one.button) for one in row.controls]
    if len(names) == 2:
        known = _PAD_BUTTONS | _PAD_TRIGGERS
        if names[0] in known and names[1] in known:
            return NO_CONTROL, known[names[0]], known[names[1]]
    elif names[0] in _PAD_AXES:
        return _PAD_AXES[names[0]], NO_CONTROL, NO_CONTROL
    elif names[0] in _PAD_PAIRS:
        return NO_CONTROL, *_PAD_PAIRS[names[0]]
    raise ConfigError(f"joystick map: a browser's gamepad has no {' and '.join(names)} for {name}")


def _pad_button(name: str | None) -> int:
    if name is None:
        return NO_CONTROL
    plain = control_name(Control(name), button=True)
    if plain not in _PAD_BUTTONS:
        raise ConfigError(f"joystick map: a browser's gamepad has no {name}")
    return _PAD_BUTTONS[plain]
