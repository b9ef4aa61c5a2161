"""`kontur-av bench tasks`: passes in which a simulated cosmonaut does the tasks of a plan."""

import argparse
from contextlib import closing
from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.table import Table

from kontur_av.errors import ConfigError
from pipelines.report.console import open_console
from pipelines.report.report_file import check_writable
from pipelines.report.result_file import write_result
from pipelines.session.children import ended_alike
from pipelines.session.options import (
    add_radio_argument,
    add_setup_argument,
    radio_change,
)
from pipelines.session.setup.setup_file import load_setup
from pipelines.virtual.campaign.options import add_place_arguments, cluster_of, jobs_of
from pipelines.virtual.campaign.sessions import session_results
from pipelines.virtual.campaign.task_figures import (
    Session,
    faults,
    headings,
    headlines,
    markdown,
    summary,
    table_rows,
    task_pass,
)
from pipelines.virtual.campaign.tasks import Crash, SessionTask
from telepresence.tasks.plan import PlannedTask, SessionPlan
from telepresence.tasks.plan_file import load_plan
from telepresence.tasks.task_files import built_in_tasks

#: As many as Kontur-2 flew in 2015 and 2016.
_SESSIONS = 23
_TASKS = ("aiming", "pursuit", "contour", "spring")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `kontur-av bench tasks`."""
    add_setup_argument(parser, default="spacejustin")
    parser.add_argument(
        "--plan",
        type=Path,
        metavar="PLAN.toml",
        help=f"the tasks of each session (default: {', '.join(_TASKS)}, again and again)",
    )
    parser.add_argument(
        "--sessions",
        type=int,
        default=_SESSIONS,
        metavar="N",
        help=f"how many, each with a seed of its own (default {_SESSIONS})",
    )
    parser.add_argument(
        "--seconds", type=float, default=480.0, metavar="S", help="of virtual time (default 480)"
    )
    add_radio_argument(parser, default="iss-pass")
    parser.add_argument("--first-seed", type=int, default=1, metavar="N", help="(default 1)")
    add_place_arguments(parser)
    parser.add_argument(
        "--media", action="store_true", help="with pictures and voices: a hundred times as long"
    )
    parser.add_argument("--report", type=Path, metavar="FILE", help="write all figures as JSON")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="write the table")


def run(args: argparse.Namespace) -> int:
    """Run the sessions, and print the table; 1 if a pass was not usable."""
    if not 1 <= args.sessions <= 1000:
        raise ConfigError(f"--sessions {args.sessions}: give 1 to 1000")
    if not 1 <= args.seconds <= 100_000:
        raise ConfigError(f"--seconds {args.seconds:g}: give 1 to 100000")
    check_writable(args.report)
    check_writable(args.markdown, "--markdown")
    jobs, setup = jobs_of(args), load_setup(args.setup, changes=radio_change(args.radio))
    if args.plan is None:
        tasks = tuple(PlannedTask(name=name) for name in _TASKS)
        plan, catalogue = SessionPlan(tasks=tasks, again=True), built_in_tasks()
    else:
        plan, catalogue = load_plan(args.plan)
    plan.check(catalogue, setup.cameras, setup.name)
    names = tuple(dict.fromkeys(planned.name for planned in plan.tasks))
    seeds = range(args.first_seed, args.first_seed + args.sessions)
    wanted = [
        SessionTask(
            setup=setup,
            seconds=args.seconds,
            seed=seed,
            media=args.media,
            plan=(plan, catalogue),
        )
        for seed in seeds
    ]
    console = open_console(args, width=150)
    sessions: dict[int, Session] = {}
    ended_early = False
    try:
        with (
            ended_alike(),
            cluster_of(args) as cluster,
            closing(session_results(wanted, jobs=jobs, cluster=cluster)) as runs,
        ):
            for number, result in runs:
                session: Session = (
                    result
                    if isinstance(result, Crash)
                    else task_pass(result.report, start_s=setup.radio_profile.start_s)
                )
                sessions[seeds[number]] = session
                verdict = ", ".join(faults(session)) or "usable"
                console.print(f"seed {seeds[number]}: {verdict}", highlight=False)
    except KeyboardInterrupt:
        ended_early = True
    if not sessions:
        console.print("ended before the first session was over")
        return 1
    early = f", ended early after {len(sessions)} of {args.sessions}" if ended_early else ""
    media = "" if args.media else " without media"
    title = (
        f"{len(sessions)} sessions of {args.setup}{media}, {args.seconds:g} s each, radio "
        f"{args.radio}, on virtual time{early}; of each task: finished runs, median time"
    )
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for heading in headings(names):
        table.add_column(heading, justify="left" if heading == "verdict" else "right")
    for row in table_rows(sessions, names):
        table.add_row(*row)
    console.print(table)
    console.print(summary(sessions), highlight=False)
    for seed in sorted(sessions):
        if isinstance(one := sessions[seed], Crash):
            console.print(f"seed {seed}: {one.error}", markup=False, highlight=False)
    ordered = {str(seed): sessions[seed] for seed in sorted(sessions)}
    write_result(args.report, {"sessions": ordered}, headlines(sessions, names))
    if args.markdown is not None:
        args.markdown.write_text(markdown(sessions, names, title), encoding="utf-8")
    return 1 if ended_early or any(map(faults, sessions.values())) else 0
