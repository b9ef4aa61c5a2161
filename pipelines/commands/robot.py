"""`kontur-av robot`: check a user's robot, or let a session's joystick drive it."""

import argparse
from collections.abc import Sequence
from contextlib import closing
from math import hypot

from kontur_av.clock import MonotonicClock
from kontur_av.errors import ConfigError
from pipelines.commands.check_results import SETUP_ROW, axes_of, print_results
from pipelines.commands.common import say_unprotected
from pipelines.commands.drive import add_way_arguments, reached
from pipelines.hand.driver_checks import RobotCheck
from pipelines.hand.haptic_loop import new_boot_id
from pipelines.hand.haptics import robot_side
from pipelines.hand.partner_arm import PoweredRobot, run_side, told
from pipelines.hand.safety_ends import within
from pipelines.hand.timed_calls import timed
from pipelines.report.report_file import WordsConsole
from pipelines.session.command_process import ended_alike
from pipelines.session.option_rows import add_actions
from telepresence.haptics.envelope import SafetyEnvelope, SafetyLimits
from telepresence.haptics.robot import Robot
from telepresence.haptics.robot_device import SIMULATED_ROBOT
from telepresence.haptics.specs import check_robot, load_robot, open_robot


def add_arguments(parser: argparse.ArgumentParser) -> None:
    check = (
        "do what a session will do, and say what the robot does wrong; IT MOVES",
        "robot SPEC  as of `stream --robot`",
        SETUP_ROW,
    )
    serve = (
        "let a session's joystick drive a partner's robot: the Russian experiment",
        f"--robot SPEC <={SIMULATED_ROBOT}>  as of `stream` (default: sim, with its task board)",
        SETUP_ROW,
    )
    add_way_arguments(add_actions(parser, {"check": check, "serve": serve})["serve"])


def run(args: argparse.Namespace) -> int:
    """0 if all is well; 1 if a check failed, or no joystick came."""
    axes = axes_of(args.setup)
    if args.action == "serve":
        return _serve(args, axes or ())
    if axes is not None:
        # Before it has power, if its facts are known then.
        check_robot(args.robot, axes, felt=False)
    device = load_robot(args.robot, axes or ())
    if isinstance(device, Robot):
        raise ConfigError(f"robot {args.robot} has no driver to check: write module:Class or udp:")
    say_unprotected(args.robot)
    console = WordsConsole()
    console.print(f"{args.robot}; it moves a few centimetres", highlight=False)
    # Whatever ends it, the robot is switched off.
    with ended_alike(), timed(device) as robot:
        return print_results(console, list(RobotCheck(robot, MonotonicClock(), axes).run()))


def _serve(args: argparse.Namespace, axes: Sequence[str]) -> int:
    """Serve the robot until it is stopped; 0 if the joystick has driven it, else 1."""
    say_unprotected(args.robot)
    with closing(open_robot(args.robot, axes)) as robot:
        envelope = SafetyEnvelope(within(SafetyLimits(), robot.capabilities))
        side = robot_side(envelope, boot_id=new_boot_id(), robot=robot)
        powered = PoweredRobot(robot, envelope)
        began_m, most_m, most_n = (robot.x_m, robot.y_m), 0.0, 0.0

        def work(now_ns: int) -> None:
            nonlocal most_m, most_n
            command = side.link.latest(now_ns)
            if envelope.stopped and command is not None and not command.stop:
                # Samples without a stop mean that the session in space has released it.
                envelope.handle_stop_released(now_ns)
            powered.watch(now_ns)
            powered.recover()
            most_m = max(most_m, hypot(robot.x_m - began_m[0], robot.y_m - began_m[1]))
            most_n = max(most_n, hypot(robot.push_x_n, robot.push_y_n))

        with reached(args, "robot") as way:
            run_side(side, work, way, args.seconds)
    print(f"the tip went {most_m * 1e3:.0f} mm far, and felt up to {most_n:.1f} N")
    return told(side, "joystick")
