"""`kontur-av joystick`: list the joysticks here, check or test one, or drive a robot with one."""

import argparse
from collections.abc import Sequence
from pathlib import Path

from kontur_av.clock import MonotonicClock
from kontur_av.errors import ConfigError
from pipelines.commands import drive
from pipelines.commands.check_results import SETUP_ROW, axes_of, joystick_report, print_results
from pipelines.commands.common import say_unprotected
from pipelines.hand.driver_checks import JoystickCheck, run_live, run_virtually
from pipelines.hand.timed_calls import timed
from pipelines.report.report_file import WordsConsole, check_writable, write_report
from pipelines.session.command_process import ended_alike, output_that_may_fail, stopped_by_signals
from pipelines.session.option_rows import add_actions
from telepresence.haptics.device.checks import CHECKS, CheckBench
from telepresence.haptics.device.gamepad import GamepadDevice, asked_map, find_gamepads
from telepresence.haptics.device.simulated import FAULTS
from telepresence.haptics.device.stick_map import StickMap
from telepresence.haptics.specs import PAGE, ROS2_HAND, is_simulated, open_alone

_ALL = "all"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """`list`, `check`, `test` and `drive`, with their options."""
    check = (
        "do what a session will do, and say what the joystick does wrong; IT MOVES",
        *("joystick SPEC  as of `stream --joystick`", SETUP_ROW, "--joystick-map"),
    )
    test = (
        "calibrate, and do functional checks, each against its limits",
        f"check <{'|'.join([*CHECKS, _ALL])}?={_ALL}>",
        "--device SPEC <=sim>  as of `stream --joystick`, or sim:FAULT; no page, no ros2 (default: "
        "sim)",
        *("--joystick-map", "--report"),
    )
    actions = {
        "list": ("list the joysticks here, by SPEC",),
        "check": check,
        "test": test,
        "drive": ("drive the robot, or the arm, that a session's setup gives a partner",),
    }
    drive.add_arguments(add_actions(parser, actions)["drive"])


def run(args: argparse.Namespace) -> int:
    """0 if all is well; 1 if a check failed."""
    if args.action == "list":
        return _list()
    if args.action == "drive":
        return drive.drive(args)
    if args.action == "check":
        return _check(args.joystick, axes_of(args.setup), asked_map(args.joystick_map))
    return _test(args.device, args.check, args.report, asked_map(args.joystick_map))


def _list() -> int:
    def row(spec: str, what: str) -> None:
        print(f"{spec:<32} {what}")

    row("sim", f"the simulated joystick: motors, {len(FAULTS)} faults to check the checks with")
    for fault in FAULTS:
        row(f"sim:{fault}", "the same with this fault")
    row(PAGE, "the simulated one in the hand of a person at a page; in a session only")
    row(ROS2_HAND, "the same in the hand of a ROS 2 node, with `stream --ros2`")
    try:
        found = find_gamepads()
        for one in found:
            row(f"evdev:{one.path}", one.problem or ", ".join((one.name, *one.more)))
        if not found:
            print("no game controller here; the first that is plugged in is called evdev")
    except ConfigError as error:
        print(str(error))
    row("udp:HOST:PORT[:KEYFILE]", "a controller in any language; with a key on any machine")
    print("use: kontur-av joystick test --device SPEC, kontur-av stream --joystick SPEC")
    return 0


def _check(spec: str, axes: Sequence[str] | None, mapping: StickMap | None) -> int:
    say_unprotected(spec)
    device, console = open_alone(spec, axes=axes, mapping=mapping), WordsConsole()
    if isinstance(device, GamepadDevice):
        console.print("\n".join(device.mapped), highlight=False)
    console.print(
        f"{device.capabilities.name}; it moves a few centimetres: hands off", highlight=False
    )
    # Whatever ends it, the joystick is closed.
    with ended_alike(), timed(device) as joystick:
        return print_results(console, list(JoystickCheck(joystick, MonotonicClock()).run()))


def _test(spec: str, check: str, report: Path | None, mapping: StickMap | None) -> int:
    check_writable(report)
    say_unprotected(spec)
    device, console = open_alone(spec, axes=None, mapping=mapping), WordsConsole()
    bench = CheckBench(device, list(CHECKS) if check == _ALL else [check])
    try:
        if is_simulated(spec):
            seconds = run_virtually(bench)
            console.print(
                f"{device.capabilities.name}, {seconds:.0f} s of virtual time", highlight=False
            )
        else:
            console.print(f"{device.capabilities.name}; Ctrl-C ends", highlight=False)
            with stopped_by_signals() as stopped:
                seconds = run_live(bench, MonotonicClock(), stopped, console.print)
    finally:
        device.close()
    with output_that_may_fail():
        code = print_results(console, bench.results)
        if not bench.done:
            code = 1
            console.print(f"ended before {bench.current} was done", highlight=False)
    if report is not None:
        write_report(report, joystick_report(spec, bench, seconds, passed=code == 0))
    return code
