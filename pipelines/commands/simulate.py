"""`kontur-av simulate`: a session on virtual time, as fast as the machine goes."""

import argparse
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import fields

from kontur_av.errors import ConfigError
from pipelines.media.media_metrics import CodingCosts
from pipelines.recording.replay_setup import load_replay
from pipelines.report.model import SessionReport
from pipelines.report.report_file import check_writable, end_report
from pipelines.session.command_process import stopped_by_signals
from pipelines.session.option_rows import add_options, refuse_options
from pipelines.session.options import add_session_options, asked_setup, stream_options
from pipelines.virtual.media import check_virtual_sources
from pipelines.virtual.session import parse_selections
from pipelines.virtual.simulate import replay, simulate
from telepresence.haptics.device.device import JoystickDevice
from telepresence.haptics.hand import Hand
from telepresence.haptics.robot import Robot
from telepresence.haptics.specs import GAME_CONTROLLER, PAGE, ROS2_HAND, open_device, open_robot
from telepresence.haptics.udp_line import UDP
from telepresence.tasks.plan import TaskWorld
from telepresence.tasks.task_files import load_plan


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `kontur-av simulate`."""
    add_session_options(parser, "setup")
    add_options(
        parser,
        "--seconds S <float>  of virtual time",
        "--replay FILE.mcap <Path>  send a recording again; default: with its setup, radio and "
        "seed",
    )
    add_options(parser, "--recode", "--cap-kbps")
    add_session_options(
        parser,
        "radio",
        "radio_start",
        "radio_delay_ms",
        "seed",
        "deadband",
        "hand",
        "force",
        "repair",
        "path",
        "path_batch_ms",
    )
    parser.set_defaults(seed=None)
    add_options(
        parser,
        "--source NAME=SPEC <*>  as of `stream`: scene:NAME, a media file or mcap:FILE#CHANNEL",
    )
    add_virtual_arguments(parser)
    add_options(parser, "--report", "-q")


def run(args: argparse.Namespace) -> int:
    """Run the simulation; 1 if its report names a failure.

    Ctrl-C and SIGTERM end it early; the report then covers the time until then.
    """
    if args.seconds is not None and not 0 < args.seconds < 1e6:
        raise ConfigError(f"--seconds {args.seconds:g}: give a number above 0 and below 1000000")
    costs = CodingCosts(**{cost.name: getattr(args, cost.name) for cost in fields(CodingCosts)})
    check_writable(args.report)
    report = _simulate(args, costs) if args.replay is None else _replay(args, costs)
    return end_report(report, args.report, quiet=args.quiet)


def _simulate(args: argparse.Namespace, costs: CodingCosts) -> SessionReport:
    for option in ("setup", "seconds"):
        if getattr(args, option) is None:
            raise ConfigError(f"--{option} is missing: a simulation without --replay needs it")
    refuse_options(args, " changes a replay: give --replay, too", "recode", "cap_kbps")
    setup = asked_setup(stream_options(args))
    check_virtual_sources(setup)
    selections = parse_selections(args.select, setup, args.seconds)
    plan = None if args.plan is None else load_plan(args.plan)
    if plan is not None:
        plan[0].check(plan[1], TaskWorld(cameras=setup.cameras, setup=setup.name))
    if plan is not None and args.joystick is not None:
        raise ConfigError("--plan has a joystick of its own: leave --joystick out")
    with (
        opened_devices(args, setup.more_axes, felt=setup.force == "felt") as (robot, joystick),
        stopped_by_signals() as stopped,
    ):
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


def _replay(args: argparse.Namespace, costs: CodingCosts) -> SessionReport:
    why = " changes what is sent: a replay sends what was recorded"
    given = ("source", "select", "deadband", "hand", "force", "plan", "robot", "joystick")
    refuse_options(args, why, *given)
    session, setup = load_replay(args, args.replay)
    with stopped_by_signals() as stopped:
        return replay(
            session,
            setup,
            seconds=args.seconds,
            seed=session.metadata.seed if args.seed is None else args.seed,
            media=not args.no_media,
            costs=costs,
            recode=str(args.replay) if args.recode else None,
            stopped=stopped,
        )


#: Kinds of robots and joysticks whose time is not ours.
_REAL_TIME = (PAGE, ROS2_HAND, GAME_CONTROLLER, UDP)


def add_virtual_arguments(parser: argparse.ArgumentParser) -> None:
    add_options(
        parser,
        "--select T=CAMERA <*>  the operator selects CAMERA at second T; repeatable",
        "--plan PLAN.toml <Path>  tasks for a simulated cosmonaut (docs/ground-control.md)",
        "--robot SPEC  sim (the default), or your own simulated module:Class",
        "--joystick SPEC  sim, sim:FAULT or your own, with calibration, states and faults "
        "(default: always in the application)",
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
    args: argparse.Namespace, axes: Sequence[str], *, felt: bool = True
) -> Iterator[tuple[Robot | None, JoystickDevice | None]]:
    """Yield what the options name, with these axes; ConfigError for what lives in real time."""
    robot: Robot | None = None
    joystick: JoystickDevice | None = None
    with ExitStack() as opened:
        if _named(args, "joystick"):
            joystick = open_device(args.joystick, hand=Hand(), axes=axes)
            opened.callback(joystick.close)
        if _named(args, "robot"):
            robot = open_robot(args.robot, axes, felt=felt)
            opened.callback(robot.close)
        yield robot, joystick


def _named(args: argparse.Namespace, option: str) -> bool:
    spec = getattr(args, option)
    if spec is not None and spec.partition(":")[0] in _REAL_TIME:
        raise ConfigError(
            f"--{option} {spec}: lives in real time; a simulation takes sim or module:Class"
        )
    return spec is not None
