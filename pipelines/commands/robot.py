"""`kontur-av robot`: check a user's robot."""

import argparse

from rich.console import Console

from kontur_av.clock import MonotonicClock
from pipelines.commands.common import say_unprotected
from pipelines.commands.joystick import results_table
from pipelines.hand.robot_check import RobotCheck
from telepresence.haptics.robot_device import RobotDevice
from telepresence.haptics.robot_spec import load_robot


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """`check`."""
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    text = "do with a robot what a session will do, and say what it does wrong; IT MOVES"
    check = actions.add_parser("check", help=text, description=text)
    check.add_argument(
        "robot",
        metavar="SPEC",
        help="udp:HOST:PORT[:KEYFILE] or module:Class, as of `stream --robot`",
    )


def run(args: argparse.Namespace) -> int:
    """0 if all is well; 1 if a check failed."""
    device: RobotDevice = load_robot(args.robot)
    say_unprotected(args.robot)
    console = Console()
    console.print("the robot moves a few centimetres", highlight=False)
    results = list(RobotCheck(device, MonotonicClock()).run())
    console.print(device.facts.name, highlight=False, markup=False)
    console.print(results_table(results))
    for result in results:
        if result.trouble:
            console.print(f"{result.name}: {result.trouble}", highlight=False, soft_wrap=True)
    return 1 if any(result.failed for result in results) else 0
