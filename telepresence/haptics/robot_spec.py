"""How a robot is named on the command line, and how it is opened.

| SPEC | what |
|---|---|
| `sim` | the simulated robot |
| `udp:HOST:PORT` | a controller in any language on this machine; with `:KEYFILE`, on any |
| `module:Class` | a user's `RobotDevice`; so is the name of an entry point of `DOOR` |
"""

from collections.abc import Sequence

from kontur_av.errors import ConfigError
from kontur_av.parts import PartDoor, make_part
from telepresence.haptics.axes import AxisName, check_axes
from telepresence.haptics.robot import Robot, RobotFacts
from telepresence.haptics.robot_device import SIMULATED_ROBOT, DrivenRobot, RobotDevice
from telepresence.haptics.udp_line import UDP

DOOR = PartDoor(
    "robot",
    "sim, udp:HOST:PORT or module:Class",
    "kontur_av.robots",
    {
        SIMULATED_ROBOT: "telepresence.haptics.robot:Robot",
        UDP: "telepresence.haptics.udp_robot:UdpRobot",
    },
)


def load_robot(spec: str, axes: Sequence[AxisName] = ()) -> RobotDevice | Robot:
    """Return the driver that `spec` names, or a robot without one, still off; ConfigError.

    axes: those behind x and y, for one that has what it is asked for.
    """
    made: RobotDevice | Robot = make_part(spec, DOOR, axes=axes)
    return made


def facts_of(spec: str) -> RobotFacts | None:
    """As `load_robot`: its facts; None for `sim`, and where only `configure` finds them out."""
    return getattr(load_robot(spec), "facts", None)


def check_robot(spec: str, axes: Sequence[AxisName] = ()) -> None:
    """Raise ConfigError if `spec` names no robot, or one with other axes; it stays off."""
    facts = getattr(load_robot(spec, axes), "facts", None)
    if facts is not None:
        check_axes(f"robot {spec}", facts.more, axes)


def open_robot(spec: str, axes: Sequence[AxisName] = ()) -> Robot:
    """Return the robot that `spec` names, with power.

    axes: those behind x and y; ConfigError for a robot that has others.
    """
    made = load_robot(spec, axes)
    robot = made if isinstance(made, Robot) else DrivenRobot(made)
    try:
        check_axes(f"robot {spec}", [axis.facts for axis in robot.more], axes)
    except ConfigError:
        robot.close()
        raise
    return robot
