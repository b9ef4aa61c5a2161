"""How a robot is named on the command line, and how it is opened.

| SPEC | what |
|---|---|
| `sim` | the simulated robot |
| `udp:HOST:PORT` | a controller in any language on this machine; with `:KEYFILE`, on any |
| `module:Class` | a user's `RobotDevice`; so is the name of an entry point of `GROUP` |
"""

from collections.abc import Sequence

from kontur_av.errors import ConfigError
from kontur_av.parts import make_part
from telepresence.haptics.axes import AxisName, check_axes
from telepresence.haptics.robot import Robot, RobotFacts
from telepresence.haptics.robot_device import SIMULATED_ROBOT, DrivenRobot, RobotDevice
from telepresence.haptics.udp_line import UDP
from telepresence.haptics.udp_robot import UdpRobot

#: The entry points of robots.
GROUP = "kontur_av.robots"


def load_robot(spec: str) -> RobotDevice:
    """Return the driver that `spec` names, all but `sim`. Nothing is switched on.

    Raises ConfigError if there is none.
    """
    kind, _, rest = spec.partition(":")
    if kind == UDP:
        return UdpRobot(rest)
    device: RobotDevice = make_part(spec, GROUP)
    return device


def facts_of(spec: str) -> RobotFacts | None:
    """What the robot that `spec` names is; None for `sim`, and where only `configure` finds it out.

    Raises ConfigError if there is none. Nothing is switched on.
    """
    return None if spec == SIMULATED_ROBOT else getattr(load_robot(spec), "facts", None)


def check_robot(spec: str, axes: Sequence[AxisName] = ()) -> None:
    """Raise ConfigError if `spec` names no robot, or one with other axes; it stays off."""
    facts = facts_of(spec)
    if facts is not None:
        check_axes(f"robot {spec}", facts.more, axes)


def open_robot(spec: str, axes: Sequence[AxisName] = ()) -> Robot:
    """Return the robot that `spec` names, with power.

    axes: those behind x and y; ConfigError for a robot that has others.
    """
    if spec == SIMULATED_ROBOT:
        return Robot(axes=axes)
    device = load_robot(spec)
    robot = DrivenRobot(device)
    try:
        check_axes(f"robot {spec}", device.facts.more, axes)
    except ConfigError:
        robot.close()
        raise
    return robot
