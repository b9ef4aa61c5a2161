"""`kontur-av bench passes`: many sessions of a whole pass, each judged as usable or not."""

import argparse
import json
from contextlib import closing
from dataclasses import asdict, replace
from hashlib import sha256
from pathlib import Path

from msgspec import convert
from rich.box import SIMPLE_HEAD
from rich.table import Table

from kontur_av.errors import ConfigError
from pipelines.bench.passes.plan import SessionPlan
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
from pipelines.session.setup.table import Setup
from pipelines.virtual.campaign.options import add_place_arguments, cluster_of, jobs_of
from pipelines.virtual.campaign.pass_figures import (
    HEADINGS,
    PassFigures,
    Session,
    faults,
    headlines,
    markdown,
    pass_figures,
    summary,
    table_rows,
)
from pipelines.virtual.campaign.sessions import session_results
from pipelines.virtual.campaign.tasks import Crash, Result

#: As many as Kontur-2 flew in 2015 and 2016.
_SESSIONS = 23


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `kontur-av bench passes`."""
    add_setup_argument(parser, default="spacejustin")
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
        "--no-media", action="store_true", help="haptics and telecommands alone: much faster"
    )
    parser.add_argument(
        "--report",
        type=Path,
        metavar="FILE",
        help="keep the figures as JSON, after each session; sessions that are in it are not run",
    )
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="write the table")


def run(args: argparse.Namespace) -> int:
    """Run what is missing, and print the table; 1 if a pass was not usable."""
    jobs, setup = jobs_of(args), _checked(args)
    plan = SessionPlan(
        setup=args.setup,
        seconds=args.seconds,
        radio=args.radio,
        media=not args.no_media,
        content=_content(setup),
    )
    sessions = _kept(args.report, plan)
    seeds = range(args.first_seed, args.first_seed + args.sessions)
    missing = [seed for seed in seeds if seed not in sessions]
    tasks = [plan.task(setup, seed) for seed in missing]
    console = open_console(args, width=150)
    if len(missing) < len(seeds):
        console.print(f"{len(seeds) - len(missing)} of {len(seeds)} are in {args.report}")
    ended_early = False
    try:
        with (
            ended_alike(),
            cluster_of(args) as cluster,
            closing(session_results(tasks, jobs=jobs, cluster=cluster)) as runs,
        ):
            for number, result in runs:
                seed = missing[number]
                session = sessions[seed] = _session(result, setup)
                _keep(args.report, plan, sessions)
                verdict = ", ".join(faults(session)) or "usable"
                took = "" if isinstance(result, Crash) else f" after {result.wall_s:.0f} s"
                console.print(f"seed {seed}: {verdict}{took}", highlight=False)
    except KeyboardInterrupt:
        ended_early = True
    wanted = {seed: sessions[seed] for seed in seeds if seed in sessions}
    if not wanted:
        console.print("ended before the first session was over")
        return 1
    title = _title(args, ended_early, len(wanted))
    console.print(_table(title, wanted))
    console.print(summary(wanted), highlight=False)
    for seed, session in wanted.items():
        for failure in [session.error] if isinstance(session, Crash) else session.failures:
            console.print(f"seed {seed}: {failure}", markup=False, highlight=False)
    if args.markdown is not None:
        args.markdown.write_text(markdown(wanted, title), encoding="utf-8")
    return 1 if ended_early or any(map(faults, wanted.values())) else 0


def _checked(args: argparse.Namespace) -> Setup:
    if not 1 <= args.sessions <= 1000:
        raise ConfigError(f"--sessions {args.sessions}: give 1 to 1000")
    if not 1 <= args.seconds <= 100_000:
        raise ConfigError(f"--seconds {args.seconds:g}: give 1 to 100000")
    check_writable(args.report)
    check_writable(args.markdown, "--markdown")
    return load_setup(args.setup, changes=radio_change(args.radio))


def _content(setup: Setup) -> str:
    """A digest of the values of setup and radio, because their files may change."""
    return sha256(repr((setup, setup.radio_profile)).encode()).hexdigest()[:16]


def _session(result: Result, setup: Setup) -> Session:
    if isinstance(result, Crash):
        return result
    return pass_figures(result.report, start_s=setup.radio_profile.start_s)


def _kept(path: Path | None, plan: SessionPlan) -> dict[int, Session]:
    """The sessions of an earlier run, without those that crashed."""
    if path is None or not path.is_file() or not path.stat().st_size:
        return {}
    try:
        kept = json.loads(path.read_text(encoding="utf-8"))
        before, sessions = SessionPlan(**kept["plan"]), kept["sessions"]
        found = {int(seed): _read(figures) for seed, figures in sessions.items()}
        # A file of another version fails here at the latest.
        list(table_rows(found))
        summary(found)
    except (ValueError, KeyError, TypeError, AttributeError):
        raise ConfigError(
            f"--report {path}: is no report of this version's `bench passes`; name another file"
        ) from None
    if before != plan:
        if replace(before, content=plan.content) == plan:
            raise ConfigError(
                f"--report {path}: its sessions have other values in {plan.setup} or {plan.radio}; "
                "name another file"
            )
        differ = next(
            f"{name.replace('media', 'media streams')} {value}"
            for name, value in asdict(before).items()
            if value != getattr(plan, name)
        )
        raise ConfigError(f"--report {path}: its sessions have {differ}; name another file")
    return {seed: session for seed, session in found.items() if isinstance(session, PassFigures)}


def _read(figures: object) -> Session:
    if isinstance(figures, dict) and "error" in figures:
        return convert(figures, Crash)
    return convert(figures, PassFigures)


def _keep(path: Path | None, plan: SessionPlan, sessions: dict[int, Session]) -> None:
    if path is not None:
        ordered = {str(seed): sessions[seed] for seed in sorted(sessions)}
        write_result(path, {"plan": plan, "sessions": ordered}, headlines(sessions))


def _title(args: argparse.Namespace, ended_early: bool, count: int) -> str:
    media = " without media" if args.no_media else ""
    early = f", ended early after {count} of {args.sessions}" if ended_early else ""
    return (
        f"{count} sessions of {args.setup}{media}, {args.seconds:g} s each, radio {args.radio}, "
        f"on virtual time{early}; latencies in ms"
    )


def _table(title: str, sessions: dict[int, Session]) -> Table:
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for heading in HEADINGS:
        table.add_column(heading, justify="left" if heading == "verdict" else "right")
    for row in table_rows(sessions):
        table.add_row(*row)
    return table
