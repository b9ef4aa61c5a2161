"""How joysticks and robots are named on the command line, and how they are opened.

| SPEC of a joystick | what |
|---|---|
| `sim` | the simulated joystick |
| `sim:FAULT` | the same, broken: see `simulated.FAULTS` |
| `page` | the simulated joystick in the hand of a person at a browser page |
| `ros2` | the same in the hand of a ROS 2 node |
| `evdev` | the first game controller |
| `evdev:PATH` | the one at PATH, such as /dev/input/event5 |
| `udp:HOST:PORT` | a controller in any language on this machine; with `:KEYFILE`, on any |
| `module:Class` | a user's `JoystickDevice`; so is an entry point of `JOYSTICK_PLUGINS` |

| SPEC of a robot | what |
|---|---|
| `sim` | the simulated robot |
| `udp:HOST:PORT` | as a joystick's |
| `module:Class` | a user's `RobotDevice`; so is the name of an entry point of `ROBOT_PLUGINS` |
"""

from collections.abc import Sequence
from typing import Any, cast
from warnings import warn

from kontur_av.errors import ConfigError
from kontur_av.parts import PluginRegistry, make_part
from kontur_av.returned import PartError
from telepresence.haptics.axes import AXIS_NAMES, check_axes, set_up_axes
from telepresence.haptics.device.device import JoystickDevice
from telepresence.haptics.device.stick_map import StickMap, pad_controls
from telepresence.haptics.device.user import UserJoystick
from telepresence.haptics.hand import Hand
from telepresence.haptics.robot import Robot, RobotCapabilities
from telepresence.haptics.robot_device import SIMULATED_ROBOT, DrivenRobot, RobotDevice
from telepresence.haptics.udp_line import UDP

SIMULATED = "sim"
PAGE = "page"
ROS2_HAND = "ros2"
GAME_CONTROLLER = "evdev"
JOYSTICK_PLUGINS = PluginRegistry(
    "joystick",
    "sim, sim:FAULT, page, ros2, evdev, evdev:/dev/input/eventN, udp:HOST:PORT or module:Class",
    "kontur_av.joysticks",
    {
        SIMULATED: "telepresence.haptics.device.simulated:open_simulated",
        PAGE: "telepresence.haptics.device.page:PageDevice",
        ROS2_HAND: "telepresence.haptics.device.page:Ros2Device",
        GAME_CONTROLLER: "telepresence.haptics.device.gamepad:open_gamepad",
        UDP: "telepresence.haptics.udp_devices:UdpJoystick",
    },
)


def open_alone(
    spec: str,
    *,
    hand: Hand | None = None,
    axes: Sequence[str] | None = (),
    mapping: StickMap | None = None,
) -> JoystickDevice:
    """Open a joystick without a session; ConfigError for one whose hand is in a session only."""
    if spec in (PAGE, ROS2_HAND):
        raise ConfigError(
            f"joystick {spec}: it is moved in a session only, with `kontur-av stream --joystick "
            f"{spec}`; its mechanics are those of sim: take that"
        )
    return open_device(spec, hand=hand, axes=axes, mapping=mapping)


def check_joystick(spec: str, axes: Sequence[str] = (), mapping: StickMap | None = None) -> None:
    """Raise ConfigError if `spec` names no joystick with these axes that can be opened now."""
    open_device(spec, axes=axes, mapping=mapping).close()


def is_simulated(spec: str) -> bool:
    """Whether `spec` names a simulated joystick or robot, which runs on virtual time."""
    return spec.partition(":")[0] == SIMULATED


def open_device(
    spec: str,
    *,
    hand: Hand | None = None,
    axes: Sequence[str] | None = (),
    mapping: StickMap | None = None,
) -> JoystickDevice:
    """Open the joystick that `spec` names; ConfigError if there is none, or it has other axes.

    hand: holds a simulated joystick in the application. axes: those behind x and y; None: any, of a
    mapping all that it names. mapping: which control of a game controller moves what.
    """
    kind, more = spec.partition(":")[0], axes
    if mapping is not None:
        if kind not in (GAME_CONTROLLER, PAGE):
            raise ConfigError(
                f"joystick {spec}: a joystick map is for evdev and page: leave it out"
            )
        if kind == PAGE:
            pad_controls(mapping, axes or ())
        if axes is None:
            more = [name for name in AXIS_NAMES if name in mapping.axis]
    device: JoystickDevice = make_part(
        spec, JOYSTICK_PLUGINS, hand=hand, axes=more or (), mapping=mapping
    )
    if kind not in JOYSTICK_PLUGINS.built_in:
        _take_former_name(device)
        try:
            device = UserJoystick(device)
        except PartError as error:
            raise PartError(f"joystick {spec}: {error}") from None
    if axes is not None:
        check_axes(f"joystick {spec}", device.capabilities.more, axes)
    return device


ROBOT_PLUGINS = PluginRegistry(
    "robot",
    "sim, udp:HOST:PORT or module:Class",
    "kontur_av.robots",
    {
        SIMULATED_ROBOT: "telepresence.haptics.robot:simulated_robot",
        UDP: "telepresence.haptics.udp_devices:UdpRobot",
    },
)


class _FormerName:
    """Reads the `facts` of a driver written for 0.1.0. Not a data descriptor: own ones win."""

    def __get__(self, device: Any, kind: type) -> object:
        if device is None:
            raise AttributeError("capabilities")
        return device.facts


def _take_former_name(device: object) -> None:
    """Let a driver without `capabilities` name them `facts`, for one release."""
    if "capabilities" not in dir(device) and "facts" in dir(device):
        warn(
            f"{type(device).__name__}.facts is called capabilities now", FutureWarning, stacklevel=2
        )
        cast(Any, type(device)).capabilities = _FormerName()


def load_robot(spec: str, axes: Sequence[str] = ()) -> RobotDevice | Robot:
    """Return the driver that `spec` names, or a robot without one, still off; ConfigError.

    axes: those behind x and y, for one that has what it is asked for.
    """
    made: RobotDevice | Robot = make_part(spec, ROBOT_PLUGINS, axes=axes)
    _take_former_name(made)
    return made


def capabilities_of(spec: str) -> RobotCapabilities | None:
    """As `load_robot`: its facts; None for `sim`, and where only `configure` finds them out."""
    return getattr(load_robot(spec), "capabilities", None)


def check_robot(spec: str, axes: Sequence[str] = (), *, felt: bool = True) -> None:
    """Raise ConfigError if `spec` names no robot, or one that does not fit; it stays off.

    felt: the session needs a robot that measures forces.
    """
    capabilities = getattr(load_robot(spec, axes), "capabilities", None)
    if capabilities is not None:
        check_axes(f"robot {spec}", capabilities.more, axes)
        _check_force(spec, capabilities, felt=felt)


def _check_force(spec: str, capabilities: RobotCapabilities, *, felt: bool) -> None:
    if felt and capabilities.force == "none":
        raise ConfigError(
            f"robot {spec}: it measures no force, so the hand can feel none: add --force none, or "
            'force = "none" to the setup'
        )


def open_robot(spec: str, axes: Sequence[str] = (), *, felt: bool = False) -> Robot:
    """Return the robot that `spec` names, with power.

    axes: those behind x and y; ConfigError for a robot that has others. felt: as of `check_robot`.
    """
    made = load_robot(spec, axes)
    try:
        robot = made if isinstance(made, Robot) else DrivenRobot(made)
    except ConfigError as error:
        raise type(error)(f"robot {spec}: {error}") from error
    try:
        check_axes(f"robot {spec}", [axis.capabilities for axis in robot.more], axes)
        if robot.capabilities is not None:
            _check_force(spec, robot.capabilities, felt=felt)
    except ConfigError:
        robot.close()
        raise
    set_up_axes(robot.more, axes, limits=True)
    return robot
