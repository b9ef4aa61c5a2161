"""`kontur-av bench replay`: one recorded session over several links, on virtual time.

Without a recording a live session is recorded first. The replays are undisturbed by what else runs.
"""

import argparse
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from rich.table import Table

from benchmarks.replay.figures import SAME, Case, ReplayResult, headlines, rows
from kontur_av.clock import NS_PER_S
from kontur_av.errors import ConfigError
from pipelines.bench.session import live_report
from pipelines.commands.replay_options import check_caps, load_recording, recorded_setup
from pipelines.recording.recorded_session import RecordedSession
from pipelines.report.console import open_console
from pipelines.report.report_file import check_writable
from pipelines.report.result_file import write_result
from pipelines.session.options import add_setup_argument, radio_change
from pipelines.session.setup.setup_file import load_setup
from pipelines.session.setup.table import Setup
from pipelines.virtual.simulate import replay


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `kontur-av bench replay`."""
    parser.add_argument(
        "--recording",
        type=Path,
        metavar="FILE.mcap",
        help="what to replay (default: a live session, recorded first)",
    )
    add_setup_argument(parser, default="spacejustin")
    parser.add_argument(
        "--seconds", type=float, default=30.0, metavar="S", help="of the recording (default 30)"
    )
    parser.add_argument(
        "--loss", type=float, default=5.0, metavar="P", help="percent of frames (default 5)"
    )
    parser.add_argument("--base-port", type=int, default=27_000, metavar="P", help="of the session")
    parser.add_argument("--report", type=Path, metavar="FILE", help="write the figures as JSON")


def run(args: argparse.Namespace) -> int:
    """Record, replay, compare; 1 if the same link did not give the same pictures."""
    if not 3 <= args.seconds <= 3600:
        raise ConfigError(f"--seconds {args.seconds:g}: give 3 to 3600")
    if not 0 < args.loss <= 50:
        raise ConfigError(f"--loss {args.loss:g}: give a number above 0, at most 50")
    check_writable(args.report)
    load_setup(args.setup)
    console = open_console(args, width=150)
    with ExitStack() as stack:
        path = args.recording
        if path is None:
            path = Path(stack.enter_context(TemporaryDirectory())) / "session.mcap"
            console.print(f"recording {args.seconds:g} s of {args.setup}", highlight=False)
            words = ["stream", "--setup", args.setup, "--no-page", "--record", str(path)]
            words += ["--base-port", str(args.base_port)]
            live_report(words, seconds=args.seconds)
        session = load_recording(path).begin(args.seconds)
        cases = []
        for name, setup, recode in _cases(path, session, args.loss):
            console.print(f"replay {name}", highlight=False)
            if not recode:
                check_caps(path, setup, session, recode=False)
            report = replay(
                session, setup, seed=session.facts.seed, recode=str(path) if recode else None
            )
            cases.append(Case(name=name, report=report))
    first_ns, last_ns = session.instants_ns
    result = ReplayResult(
        setup=session.facts.setup,
        seconds=(last_ns - first_ns) / NS_PER_S,
        cases=tuple(cases),
    )
    found = headlines(result)
    table = Table(
        title=f"{result.setup}, {result.seconds:.1f} s recorded, replayed on virtual time",
        title_justify="left",
    )
    for heading in ("", "unit", *(case.name for case in cases)):
        table.add_column(heading, justify="right" if heading not in ("", "unit") else "left")
    for row in rows(found):
        table.add_row(*row)
    console.print(table)
    for case in cases:
        for failure in case.report.failures:
            console.print(f"{case.name}: {failure}", markup=False, highlight=False)
    write_result(args.report, result, found)
    return 0 if result.sound else 1


def _cases(
    path: Path, session: RecordedSession, loss_percent: float
) -> list[tuple[str, Setup, bool]]:
    """Name, setup, and whether pictures are coded anew."""
    same = recorded_setup(path, session)
    lossy = replace(same.radio_profile, name="lossy", frame_loss=loss_percent / 100)
    loss = f"{loss_percent:g} % loss"
    with_loss = recorded_setup(path, session, {"radio": lossy, "radio_delay_ms": 0.0})
    geo = recorded_setup(path, session, radio_change("geo"))
    return [
        (SAME, same, False),
        ("geo", geo, False),
        ("geo, coded anew", geo, True),
        (loss, with_loss, False),
        (f"{loss}, coded anew", with_loss, True),
    ]
