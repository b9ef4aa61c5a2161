"""A game controller as a joystick, through evdev: the shell around `Stick`.

It has no motors that push. If it can rumble, the rumble shows the robot's force. Its stick springs
back to its middle by itself.
"""

import os
from collections.abc import Sequence
from contextlib import suppress
from math import hypot
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from kontur_av.clock import NS_PER_MS
from kontur_av.errors import ConfigError, refused
from telepresence.haptics.axes import AxisReading
from telepresence.haptics.device.device import JoystickReading
from telepresence.haptics.device.states import JoystickState
from telepresence.haptics.device.stick import (
    ABS_X,
    ABS_Y,
    EV_ABS,
    EV_FF,
    EV_KEY,
    EV_REL,
    FF_RUMBLE,
    RUMBLE_NS,
    Axis,
    RumbleMeter,
    Stick,
    dead_man_of,
    is_puck,
    puck_axes,
    stick_axes,
)
from telepresence.haptics.device.stick_map import StickMap
from telepresence.toml_file import read_toml, typed

#: The force at which the rumble is strongest (N). Chosen.
_FULL_RUMBLE_N = 8.0
#: Codes of gamepad and joystick buttons; a mouse or a touchscreen has none of them.
_FIRST_BUTTON, _LAST_BUTTON = 0x120, 0x13F


class FoundGamepad(NamedTuple):
    """A controller at `path`.

    problem: one line that says why it cannot be used, or "". more: its axes behind x and y.
    """

    path: str
    name: str
    problem: str = ""
    more: tuple[str, ...] = ()


def find_gamepads(folder: Path = Path("/dev/input")) -> list[FoundGamepad]:
    """List the controllers in `folder` by number, and devices that cannot be opened."""
    evdev = _library()
    found = []
    nodes = sorted(folder.glob("event*"), key=lambda node: (len(node.name), node.name))
    for node in nodes:
        if not os.access(node, os.R_OK):
            problem = "not permitted: add yourself to the group input and log in again"
            found.append(FoundGamepad(str(node), "", problem))
            continue
        try:
            device = evdev.InputDevice(str(node))
        except OSError as error:
            found.append(FoundGamepad(str(node), "", f"cannot be opened: {error.strerror}"))
            continue
        with suppress(OSError):
            if _is_stick(device):
                capabilities = device.capabilities(absinfo=False)
                codes = capabilities.get(EV_ABS) or capabilities[EV_REL]
                more = stick_axes(codes, capabilities[EV_KEY])
                found.append(FoundGamepad(str(node), device.name, more=more))
        device.close()
    return found


def open_gamepad(
    path: str = "",
    *,
    axes: Sequence[str] = (),
    mapping: StickMap | None = None,
    folder: Path = Path("/dev/input"),
) -> "GamepadDevice":
    """Open the controller at `path`, or the first one; ConfigError if there is none.

    axes: those behind x and y, as far as it has them. mapping: which control moves what; with one,
    the device at `path` may be any that has them.
    """
    evdev = _library()
    if not path:
        usable = [gamepad for gamepad in find_gamepads(folder) if not gamepad.problem]
        if not usable:
            raise ConfigError(
                "no game controller here: plug one in (`kontur-av joystick list` shows what is "
                "there), or use sim"
            )
        path = usable[0].path
    try:
        device = evdev.InputDevice(path)
    except PermissionError:
        raise ConfigError(
            f"evdev:{path} is not permitted: add yourself to the group input and log in again"
        ) from None
    except OSError as error:
        raise ConfigError(
            f"evdev:{path} is no input device ({error.strerror}): `kontur-av joystick list` shows "
            "what is there"
        ) from None
    if mapping is None and not _is_stick(device):
        device.close()
        raise ConfigError(
            f"evdev:{path} is no game controller: `kontur-av joystick list` shows what is there"
        )
    keys = frozenset(device.capabilities().get(EV_KEY, ()))
    if mapping is None and dead_man_of(keys) is None:
        device.close()
        raise ConfigError(
            f"evdev:{path} has no button to be the dead-man button: take a controller with one"
        )
    try:
        return GamepadDevice(device, axes, mapping)
    except ConfigError as error:
        device.close()
        raise ConfigError(f"joystick map: {error}") from None


def read_stick_map(path: Path) -> StickMap:
    """Return the mapping in a TOML file; ConfigError, in one line."""
    table = read_toml(path, "joystick map")
    with refused(f"joystick map {path}", ConfigError):
        return typed(table, StickMap, "a joystick map")


def asked_map(path: Path | None) -> StickMap | None:
    """Return the mapping of a file; None without one. ConfigError."""
    return None if path is None else read_stick_map(path)


class GamepadDevice:
    """One open controller. `device` is an `evdev.InputDevice`, which `close` closes.

    axes: those behind x and y, as far as it has them. mapping: as of `Stick`; so is mapped.
    """

    def __init__(
        self, device: Any, axes: Sequence[str] = (), mapping: StickMap | None = None
    ) -> None:
        capabilities = device.capabilities(absinfo=True)
        self._device = device
        described = capabilities.get(EV_ABS, ())
        self._relative = not described and bool(capabilities.get(EV_REL))
        self._stick = Stick(
            device.name,
            puck_axes()
            if self._relative
            else {
                code: Axis(info.value, info.min, info.max, info.flat) for code, info in described
            },
            frozenset(capabilities.get(EV_KEY, ())),
            rumble=FF_RUMBLE in capabilities.get(EV_FF, ()),
            more=axes,
            mapping=mapping,
        )
        self.capabilities, self.mapped = self._stick.capabilities, self._stick.mapped
        self._meter = RumbleMeter(_FULL_RUMBLE_N)
        self._effect = -1
        self._force_n = self._more_n = 0.0
        self._ask_state()

    def read(self) -> JoystickReading:
        """Process all pending events, then return the reading."""
        feed(self._stick, self._device)
        if self._stick.needs_state and self._stick.present:
            self._ask_state()
        return self._stick.reading()

    def set_zero(self, x_m: float, y_m: float) -> None:
        """Make the present position (x_m, y_m) the middle."""
        self._stick.handle_zero(x_m, y_m)

    def write_force(self, x_n: float, y_n: float) -> None:
        """Show the size of the force as rumble, on a controller that has it."""
        self._force_n = hypot(x_n, y_n)

    def read_more(self) -> list[AxisReading]:
        """Return the places behind x and y, as of the last `read`."""
        return self._stick.more_readings()

    def write_more_forces(self, forces: Sequence[float]) -> None:
        """Show their size (N; N m), too."""
        more = zip(forces, self.capabilities.more, strict=True)
        self._more_n = hypot(*(force / capabilities.lever_m for force, capabilities in more))

    def write_leds(self, mask: int) -> None:
        """Do nothing: the kernel uses a controller's LEDs for the player number."""

    def show_state(self, state: JoystickState) -> None:
        """Do nothing: a controller has no light for the state."""

    def advance(self, dt_ns: int) -> None:
        """`dt_ns` pass; update the filter and the rumble."""
        self._stick.advance(dt_ns)
        if self.capabilities.rumble:
            magnitude = self._meter.handle_force(hypot(self._force_n, self._more_n), dt_ns)
            if magnitude is not None:
                self._rumble(magnitude)

    def close(self) -> None:
        """Stop the rumble and close the device."""
        if self._effect >= 0:
            self._rumble(0)
        self._device.close()

    def _ask_state(self) -> None:
        try:
            codes = () if self._relative else self._stick.codes
            raw = {code: self._device.absinfo(code).value for code in codes}
            self._stick.handle_state(raw, self._device.active_keys())
        except OSError:
            self._stick.handle_gone()

    def _rumble(self, magnitude: int) -> None:
        ff = _library().ff
        effect = ff.Effect(
            FF_RUMBLE,
            self._effect,
            0,
            ff.Trigger(0, 0),
            ff.Replay(RUMBLE_NS // NS_PER_MS, 0),
            ff.EffectType(
                ff_rumble_effect=ff.Rumble(
                    strong_magnitude=magnitude, weak_magnitude=magnitude // 2
                )
            ),
        )
        # Writing fails while a controller is being unplugged; the next reading reports that.
        with suppress(OSError):
            self._effect = self._device.upload_effect(effect)
            self._device.write(EV_FF, self._effect, 1 if magnitude else 0)


def feed(stick: Stick, device: Any) -> None:
    """Pass all events that `device` (an `evdev.EventIO`) has now to `stick`."""
    try:
        for event in device.read():
            stick.handle_event(event.type, event.code, event.value)
    except BlockingIOError:
        return
    except OSError:
        stick.handle_gone()


def _is_stick(device: Any) -> bool:
    capabilities = device.capabilities(absinfo=False)
    axes, keys = capabilities.get(EV_ABS, ()), capabilities.get(EV_KEY, ())
    if is_puck(axes or capabilities.get(EV_REL, ()), keys):
        return True
    return (
        ABS_X in axes
        and ABS_Y in axes
        and any(_FIRST_BUTTON <= code <= _LAST_BUTTON for code in keys)
    )


def _library() -> ModuleType:
    try:
        import evdev
    except ImportError:
        raise ConfigError(
            "a game controller needs the library evdev: pip install -e '.[joystick]'"
        ) from None
    library: ModuleType = evdev
    return library
