"""`kontur-av robot`: check a user's robot."""

import argparse

from rich.console import Console

from kontur_av.clock import MonotonicClock
from pipelines.commands.check_results import print_results
from pipelines.commands.common import say_unprotected
from pipelines.hand.robot_check import RobotCheck
from telepresence.haptics.robot_device import RobotDevice
from telepresence.haptics.robot_spec import load_robot


def add_arguments(parser: argparse.ArgumentParser) -> None:
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
    console.print(f"{args.robot}; it moves a few centimetres", highlight=False)
    return print_results(console, list(RobotCheck(device, MonotonicClock()).run()))
