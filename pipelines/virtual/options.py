"""The options of a session on virtual time: its script, its devices, and what coding costs."""

import argparse
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import fields

from kontur_av.errors import ConfigError
from pipelines.report.model import CodingCosts
from pipelines.session.option_rows import add_options
from telepresence.haptics.axes import AxisName
from telepresence.haptics.device.device import JoystickDevice
from telepresence.haptics.hand import Hand
from telepresence.haptics.robot import Robot
from telepresence.haptics.specs import GAME_CONTROLLER, PAGE, ROS2_HAND, open_device, open_robot
from telepresence.haptics.udp_line import UDP

#: Kinds of robots and joysticks whose time is not ours.
_REAL_TIME = (PAGE, ROS2_HAND, GAME_CONTROLLER, UDP)


def add_virtual_arguments(parser: argparse.ArgumentParser) -> None:
    add_options(
        parser,
        "--select T=CAMERA <*>  the operator selects CAMERA at second T; repeatable",
        "--plan PLAN.toml <Path>  tasks that a simulated cosmonaut does, one after the other "
        "(docs/tasks.md)",
        "--robot SPEC  sim, or a simulated robot of your own: module:Class (default: sim)",
        "--joystick SPEC  sim, sim:FAULT or your own simulated one, with calibration, states and "
        "faults; without, always in the application",
        "--no-media  haptics and telecommands alone: much faster",
    )
    for cost in fields(CodingCosts):
        what = cost.name.removesuffix("_ms").replace("_", " ")
        add_options(
            parser,
            f"--{cost.name.replace('_', '-')} MS <float={cost.default}>  virtual time to {what} "
            f"({cost.default} ms)",
        )


@contextmanager
def opened_devices(
    args: argparse.Namespace, axes: Sequence[AxisName]
) -> Iterator[tuple[Robot | None, JoystickDevice | None]]:
    """Yield what the options name, with these axes; ConfigError for what lives in real time."""
    robot: Robot | None = None
    joystick: JoystickDevice | None = None
    with ExitStack() as opened:
        if _named(args, "joystick"):
            joystick = open_device(args.joystick, hand=Hand(), axes=axes)
            opened.callback(joystick.close)
        if _named(args, "robot"):
            robot = open_robot(args.robot, axes)
            opened.callback(robot.close)
        yield robot, joystick


def _named(args: argparse.Namespace, option: str) -> bool:
    spec = getattr(args, option)
    if spec is not None and spec.partition(":")[0] in _REAL_TIME:
        raise ConfigError(
            f"--{option} {spec}: lives in real time; a simulation takes sim or module:Class"
        )
    return spec is not None


def costs_of(args: argparse.Namespace) -> CodingCosts:
    return CodingCosts(**{cost.name: getattr(args, cost.name) for cost in fields(CodingCosts)})
