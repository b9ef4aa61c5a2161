"""How a joystick is named on the command line, and how it is opened.

| SPEC | what |
|---|---|
| `sim` | the simulated joystick |
| `sim:FAULT` | the same, broken: see `simulated.FAULTS` |
| `page` | the simulated joystick in the hand of a person at a browser page |
| `evdev` | the first game controller |
| `evdev:PATH` | the one at PATH, such as /dev/input/event5 |
| `udp:HOST:PORT` | a controller in any language on this machine; with `:KEYFILE`, on any |
| `module:Class` | a user's `JoystickDevice`; so is the name of an entry point of `GROUP` |
"""

from collections.abc import Callable, Sequence

from kontur_av.errors import ConfigError
from kontur_av.parts import make_part, names_part
from telepresence.haptics.axes import AxisName, check_axes
from telepresence.haptics.device.device import JoystickDevice
from telepresence.haptics.device.gamepad import open_gamepad
from telepresence.haptics.device.page import PageDevice
from telepresence.haptics.device.simulated import FAULTS, SimulatedDevice
from telepresence.haptics.device.udp_joystick import UdpJoystick
from telepresence.haptics.hand import Hand
from telepresence.haptics.udp_line import UDP

SIMULATED = "sim"
PAGE = "page"
GAME_CONTROLLER = "evdev"
#: The entry points of joysticks.
GROUP = "kontur_av.joysticks"


def check_joystick(spec: str, axes: Sequence[AxisName] = ()) -> None:
    """Raise ConfigError if `spec` names no joystick with these axes that can be opened now."""
    if not is_simulated(spec):
        open_device(spec, axes=axes).close()
    else:
        _fault(spec)


def is_simulated(spec: str) -> bool:
    """Whether `spec` names a simulated joystick, which runs on virtual time."""
    return spec.partition(":")[0] == SIMULATED


def open_device(
    spec: str, *, hand: Hand | None = None, axes: Sequence[AxisName] = ()
) -> JoystickDevice:
    """Open the joystick that `spec` names; ConfigError if there is none, or it has other axes.

    hand: holds a simulated joystick in the application. axes: those behind x and y.
    """
    device = _open(spec, hand, axes)
    check_axes(f"joystick {spec}", device.facts.more, axes)
    return device


def _open(spec: str, hand: Hand | None, axes: Sequence[AxisName]) -> JoystickDevice:
    kind, _, rest = spec.partition(":")
    if kind == SIMULATED:
        fault = _fault(spec)
        return SimulatedDevice(FAULTS[fault] if fault else None, hand=hand, axes=axes)
    if spec == PAGE:
        return PageDevice(axes=axes)
    if opened := _BY_KIND.get(kind):
        return opened(rest)
    if not names_part(spec, GROUP):
        raise ConfigError(
            f"joystick {spec!r}: write sim, sim:FAULT, page, evdev, evdev:/dev/input/eventN, "
            "udp:HOST:PORT or module:Class"
        )
    device: JoystickDevice = make_part(spec, GROUP)
    return device


#: What is opened with the text after the colon.
_BY_KIND: dict[str, Callable[[str], JoystickDevice]] = {
    GAME_CONTROLLER: open_gamepad,
    UDP: UdpJoystick,
}


def _fault(spec: str) -> str:
    fault = spec.partition(":")[2]
    if fault and fault not in FAULTS:
        raise ConfigError(f"joystick {spec!r}: the faults are {', '.join(FAULTS)}")
    return fault
