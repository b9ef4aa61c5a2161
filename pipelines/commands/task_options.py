"""Options of `kontur-av stream` for tasks."""

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path

from kontur_av.errors import ConfigError
from pipelines.commands.live_session import made_directory
from pipelines.mission.mission import TaskWish
from pipelines.session.addresses import split_address
from pipelines.session.option_rows import add_options, refuse_options
from pipelines.session.setup.segments import Segment
from pipelines.session.setup.table import Setup
from pipelines.session.topology import JOYSTICK, PAGES, TASKS
from telepresence.haptics.specs import facts_of, is_simulated
from telepresence.tasks.task_files import load_plan, load_tasks


def add_task_arguments(parser: argparse.ArgumentParser) -> None:
    add_options(
        parser,
        "--plan PLAN.toml <Path>  select the tasks of a plan; with a simulated joystick a "
        "simulated cosmonaut does them",
    )
    parser.add_argument(
        "--tasks",
        nargs="*",
        type=Path,
        metavar="FILE.xml",
        help="have tasks for people; with files, further ones",
    )
    add_options(
        parser,
        "--leds HOST:PORT  of an LED panel that takes the place of the built-in",
        "--runs DIR <Path>  record each run of a task into a file there",
    )


def task_wish(
    args: argparse.Namespace, setup: Setup, segments: Sequence[Segment]
) -> TaskWish | None:
    """What the options wish; None for a session without tasks. ConfigError."""
    if args.plan is None and args.tasks is None and not setup.tasks:
        refuse_options(args, " is for tasks: give --tasks or --plan, too", "leds", "runs")
        return None
    facts = facts_of(args.robot) if Segment.GROUND in segments else None
    two_hands = facts is not None and facts.two_hands and setup.partner_arm == "second"
    files = args.tasks or []
    if args.plan is None:
        plan, catalogue = None, load_tasks(files)
    elif files:
        raise ConfigError("--plan names its files itself: leave those of --tasks out")
    else:
        plan, catalogue = load_plan(args.plan)
        plan.check(catalogue, setup.cameras, setup.name, two_hands=two_hands)
    simulated = plan is not None and is_simulated(args.joystick)
    if simulated and len(segments) == 1:
        raise ConfigError(
            "a simulated cosmonaut sees the LED panel on one machine only: leave --end out, or "
            "give --tasks at both ends, and --joystick page or evdev in space"
        )
    if simulated and args.leds is not None:
        raise ConfigError(
            "a simulated cosmonaut sees only the built-in LED panel: leave --leds out"
        )
    if setup.partner_arm == "shared":
        raise ConfigError('tasks are the cosmonaut\'s: take a setup with partner_arm = "none"')
    if args.runs is not None and getattr(args, "record", None) is not None:
        raise ConfigError("--runs and --record want the same recorder: give one of them")
    leds = None if args.leds is None else split_address(args.leds, "--leds")
    runs = made_directory(args.runs, "--runs")
    return TaskWish(
        catalogue=catalogue,
        plan=plan,
        leds=leds,
        runs=None if runs is None else str(runs.resolve()),
        simulated=simulated,
        two_hands=two_hands,
    )


def task_arguments(wish: TaskWish | None) -> Mapping[str, Mapping[str, object]]:
    """By process, what it needs to know of the wish."""
    if wish is None:
        return {}
    arguments: dict[str, dict[str, object]] = {
        TASKS: {"wish": wish},
        PAGES[Segment.SPACE]: {"tasks": wish.catalogue},
    }
    if wish.simulated and wish.plan is not None:
        arguments[JOYSTICK] = {"skill": wish.plan.skill}
    return arguments
