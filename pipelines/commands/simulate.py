"""`kontur-av simulate`: a session on virtual time, as fast as the machine goes."""

import argparse
from contextlib import ExitStack, closing
from dataclasses import fields
from pathlib import Path

from kontur_av.errors import ConfigError
from pipelines.recording.replay_setup import check_caps, load_recording, replay_setup
from pipelines.report.model import CodingCosts, SessionReport
from pipelines.report.report_file import check_writable, save_report
from pipelines.report.summary import print_summary
from pipelines.session.children import stopped_by_signals
from pipelines.session.options import (
    add_coding_arguments,
    add_deadband_argument,
    add_hand_argument,
    add_radio_arguments,
    add_setup_argument,
    refuse_options,
    setup_changes,
)
from pipelines.session.output import output_that_may_fail
from pipelines.session.setup.setup_file import load_setup
from pipelines.session.setup.sources import parse_sources
from pipelines.virtual.media import check_virtual_sources
from pipelines.virtual.session import parse_selections
from pipelines.virtual.simulate import replay, simulate
from telepresence.haptics.device.spec import GAME_CONTROLLER, PAGE, ROS2_HAND, open_device
from telepresence.haptics.hand import Hand
from telepresence.haptics.robot_spec import open_robot
from telepresence.tasks.task_files import load_plan

#: Kinds of robots and joysticks whose time is not ours.
_REAL_TIME = (PAGE, ROS2_HAND, GAME_CONTROLLER, "udp")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `kontur-av simulate`."""
    add_setup_argument(parser, needed=False)
    parser.add_argument("--seconds", type=float, metavar="S", help="of virtual time")
    parser.add_argument(
        "--replay",
        type=Path,
        metavar="FILE.mcap",
        help="send a recording again, with its setup, radio and seed unless others are given",
    )
    add_coding_arguments(parser)
    add_radio_arguments(parser)
    parser.set_defaults(seed=None)
    add_deadband_argument(parser)
    add_hand_argument(parser)
    parser.add_argument(
        "--source",
        action="append",
        default=[],
        metavar="NAME=SPEC",
        help="what an input captures: scene:NAME, a media file or mcap:FILE#CHANNEL; repeatable",
    )
    parser.add_argument(
        "--select",
        action="append",
        default=[],
        metavar="T=CAMERA",
        help="the operator selects CAMERA at second T; repeatable",
    )
    parser.add_argument(
        "--plan",
        type=Path,
        metavar="PLAN.toml",
        help="tasks that a simulated cosmonaut does, one after the other (docs/tasks.md)",
    )
    parser.add_argument(
        "--robot",
        metavar="SPEC",
        help="sim, or a simulated robot of your own: module:Class (default: sim)",
    )
    parser.add_argument(
        "--joystick",
        metavar="SPEC",
        help="sim, sim:FAULT or your own simulated one, with calibration, states and faults; "
        "without, always in the application",
    )
    parser.add_argument(
        "--no-media", action="store_true", help="haptics and telecommands alone: much faster"
    )
    for cost in fields(CodingCosts):
        what = cost.name.removesuffix("_ms").replace("_", " ")
        parser.add_argument(
            f"--{cost.name.replace('_', '-')}",
            type=float,
            default=cost.default,
            metavar="MS",
            help=f"virtual time to {what} ({cost.default} ms)",
        )
    parser.add_argument("--report", type=Path, metavar="FILE", help="write the report as JSON")
    parser.add_argument("-q", "--quiet", action="store_true", help="show nothing but mistakes")


def run(args: argparse.Namespace) -> int:
    """Run the simulation; 1 if its report names a failure.

    Ctrl-C and SIGTERM end it early; the report then covers the time until then.
    """
    if args.seconds is not None and not 0 < args.seconds < 1e6:
        raise ConfigError(f"--seconds {args.seconds:g}: give a number above 0 and below 1000000")
    costs = CodingCosts(**{cost.name: getattr(args, cost.name) for cost in fields(CodingCosts)})
    check_writable(args.report)
    report = _simulate(args, costs) if args.replay is None else _replay(args, costs)
    saved = save_report(args.report, report)
    if not args.quiet:
        with output_that_may_fail():
            print_summary(report)
    return 1 if report.failures or not saved else 0


def _simulate(args: argparse.Namespace, costs: CodingCosts) -> SessionReport:
    for option in ("setup", "seconds"):
        if getattr(args, option) is None:
            raise ConfigError(f"--{option} is missing: a simulation without --replay needs it")
    refuse_options(args, " changes a replay: give --replay, too", "recode", "cap_kbps")
    setup = load_setup(
        args.setup,
        sources=parse_sources(args.source),
        changes=setup_changes(args),
        radio_start_s=args.radio_start,
    )
    check_virtual_sources(setup)
    selections = parse_selections(args.select, setup, args.seconds)
    plan = None if args.plan is None else load_plan(args.plan)
    if plan is not None:
        plan[0].check(plan[1], setup.cameras, setup.name)
    if plan is not None and args.joystick is not None:
        raise ConfigError("--plan has a joystick of its own: leave --joystick out")
    with ExitStack() as opened, stopped_by_signals() as stopped:
        joystick, axes = None, setup.more_axes
        if args.joystick is not None:
            _check_virtual("joystick", args.joystick)
            joystick = opened.enter_context(
                closing(open_device(args.joystick, hand=Hand(), axes=axes))
            )
        robot = None
        if args.robot is not None:
            _check_virtual("robot", args.robot)
            robot = opened.enter_context(closing(open_robot(args.robot, axes)))
        return simulate(
            setup,
            seconds=args.seconds,
            seed=args.seed or 0,
            media=not args.no_media,
            selections=selections,
            costs=costs,
            stopped=stopped,
            plan=plan,
            robot=robot,
            joystick=joystick,
        )


def _check_virtual(option: str, spec: str) -> None:
    if spec.partition(":")[0] in _REAL_TIME:
        raise ConfigError(
            f"--{option} {spec}: lives in real time; a simulation takes sim or module:Class"
        )


def _replay(args: argparse.Namespace, costs: CodingCosts) -> SessionReport:
    why = " changes what is sent: a replay sends what was recorded"
    given = ("source", "select", "deadband", "hand", "plan", "robot", "joystick")
    refuse_options(args, why, *given)
    session = load_recording(args.replay)
    setup = replay_setup(args, args.replay, session)
    check_caps(args.replay, setup, session, recode=args.recode)
    if args.recode and session.parts > 1:
        raise ConfigError(
            f"--recode on virtual time takes one part, and {args.replay} has {session.parts}: "
            "`kontur-av replay --recode` takes them all"
        )
    with stopped_by_signals() as stopped:
        return replay(
            session,
            setup,
            seconds=args.seconds,
            seed=session.facts.seed if args.seed is None else args.seed,
            media=not args.no_media,
            costs=costs,
            recode=str(args.replay) if args.recode else None,
            stopped=stopped,
        )
