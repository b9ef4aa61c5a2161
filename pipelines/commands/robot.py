"""`kontur-av robot`: check a user's robot, or let a session's joystick drive it."""

import argparse

from kontur_av.clock import MonotonicClock
from kontur_av.errors import ConfigError
from pipelines.commands import serve_robot
from pipelines.commands.check_results import add_setup_argument, axes_of, print_results
from pipelines.commands.common import say_unprotected
from pipelines.hand.robot_check import RobotCheck
from pipelines.report.report_file import words_console
from telepresence.haptics.robot import Robot
from telepresence.haptics.robot_spec import check_robot, load_robot


def add_arguments(parser: argparse.ArgumentParser) -> None:
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    text = "do with a robot what a session will do, and say what it does wrong; IT MOVES"
    check = actions.add_parser("check", help=text, description=text)
    check.add_argument(
        "robot",
        metavar="SPEC",
        help="udp:HOST:PORT[:KEYFILE] or module:Class, as of `stream --robot`",
    )
    add_setup_argument(check)
    text = "let the joystick of a session drive a partner's robot: its Russian experiment"
    serve_robot.add_arguments(actions.add_parser("serve", help=text, description=text))


def run(args: argparse.Namespace) -> int:
    """0 if all is well; 1 if a check failed, or no joystick came."""
    if args.action == "serve":
        return serve_robot.serve(args)
    axes = axes_of(args.setup)
    if axes is not None:
        check_robot(args.robot, axes)
    device = load_robot(args.robot, axes or ())
    if isinstance(device, Robot):
        raise ConfigError(f"robot {args.robot} has no driver to check: write module:Class or udp:")
    say_unprotected(args.robot)
    console = words_console()
    console.print(f"{args.robot}; it moves a few centimetres", highlight=False)
    return print_results(console, list(RobotCheck(device, MonotonicClock()).run()))
