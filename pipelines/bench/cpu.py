"""`kontur-av bench cpu`: what a live session costs, also beside another checkout of the project.

With `--against` the two trees take turns (A B A B ...), so that a change of the machine's load
falls on both. Each run is `kontur-av stream` in a new process.
"""

import argparse
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

from rich.table import Table

import pipelines
from kontur_av.errors import ConfigError
from pipelines.bench.session import live_report
from pipelines.report.report_file import check_writable, open_console, write_result
from pipelines.report.result import Headline, titled_table
from pipelines.session.option_rows import add_options
from pipelines.session.options import add_session_options
from pipelines.session.setup.setup_file import load_setup

_THIS_TREE = Path(str(pipelines.__file__)).parent.parent


@dataclass(frozen=True, slots=True, kw_only=True)
class CpuRun:
    """One session. cpu_s_per_s: CPU seconds of all processes and the launcher, a session second.

    video_p50_ms, video_p99_ms: the uplink's picture, capture to display; None if none came.
    """

    cpu_s_per_s: float
    video_p50_ms: float | None
    video_p99_ms: float | None


@dataclass(frozen=True, slots=True)
class CpuResult:
    """runs: of this tree; against: of the other tree, in the same order; empty without one."""

    setup: str
    seconds: float
    runs: tuple[CpuRun, ...]
    against: tuple[CpuRun, ...] = ()

    @property
    def ratios(self) -> list[float]:
        """CPU time of this tree over that of the other tree, for each pair of runs."""
        return [
            ours.cpu_s_per_s / theirs.cpu_s_per_s
            for ours, theirs in zip(self.runs, self.against, strict=False)
        ]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_session_options(parser, "setup=spacejustin")
    add_options(
        parser,
        "--against DIR <Path>  another checkout, measured in turn with this",
        "--runs N <int=5>  of each (default 5)",
        "--seconds S <float=20.0>  of each session (default 20)",
        "--base-port P <int=27000>  of the runs",
        "--report FILE <Path>  write the figures as JSON",
    )


def run(args: argparse.Namespace) -> int:
    if not 1 <= args.runs <= 1000:
        raise ConfigError(f"--runs {args.runs}: give 1 to 1000")
    if not 2 <= args.seconds <= 3600:
        raise ConfigError(f"--seconds {args.seconds:g}: give 2 to 3600")
    other = _checked_tree(args.against)
    check_writable(args.report)
    load_setup(args.setup)
    console = open_console(args)
    words = ["stream", "--setup", args.setup, "--base-port", str(args.base_port)]
    found: dict[str, list[CpuRun]] = {"this tree": []}
    trees = {"this tree": _THIS_TREE}
    if other is not None:
        found[str(args.against)] = []
        trees[str(args.against)] = other
    for number in range(1, args.runs + 1):
        for name, tree in trees.items():
            report = live_report(words, seconds=args.seconds, tree=tree)
            found[name].append(read_run(report))
            cost = found[name][-1].cpu_s_per_s
            console.print(f"run {number}, {name}: {cost:.3f} CPU s a second", highlight=False)
    ours, *others = found.values()
    against = tuple(others[0]) if others else ()
    result = CpuResult(args.setup, args.seconds, tuple(ours), against)
    console.print(_table(found, result))
    write_result(args.report, result, headlines(result))
    return 0


def _checked_tree(path: Path | None) -> Path | None:
    if path is None:
        return None
    if not (path / "pipelines" / "cli.py").is_file():
        raise ConfigError(f"--against {path}: no checkout of kontur-av (pipelines/cli.py)")
    return path.resolve()


def _table(found: dict[str, list[CpuRun]], result: CpuResult) -> Table:
    table = titled_table(
        f"{result.setup}, {len(result.runs)} sessions of {result.seconds:g} s each: "
        "median (least to most)",
        *("tree", "CPU s a second", "uplink picture p50, ms", "p99, ms"),
        left=("tree",),
    )
    for name, runs in found.items():
        table.add_row(
            name,
            _words([run.cpu_s_per_s for run in runs], 3),
            _words([run.video_p50_ms for run in runs], 1),
            _words([run.video_p99_ms for run in runs], 1),
        )
    if result.ratios:
        table.add_section()
        table.add_row("this tree over the other, pair by pair", _words(result.ratios, 3), "", "")
    return table


def _words(values: Sequence[float | None], digits: int) -> str:
    median, known = middle(values), [value for value in values if value is not None]
    if median is None:
        return "–"
    return f"{median:.{digits}f} ({min(known):.{digits}f} to {max(known):.{digits}f})"


VIDEO = "uplink_video"


def read_run(text: bytes) -> CpuRun:
    """The figures of one session's report, also of another version. KeyError for anything else."""
    report = json.loads(text)
    latency = report["streams"][VIDEO]["latency_ms"]
    came = latency["count"] > 0
    return CpuRun(
        cpu_s_per_s=report["cpu"]["total_s"] / report["seconds"],
        video_p50_ms=latency["p50"] if came else None,
        video_p99_ms=latency["p99"] if came else None,
    )


def headlines(result: CpuResult) -> list[Headline]:
    name = "this tree" if result.against else ""
    found = [*_of_tree(name, result.runs), *_of_tree("other tree", result.against)]
    if result.ratios:
        ratio = median(result.ratios)
        found.append(
            Headline(what="CPU time, this tree over the other", who="pairs", unit="", value=ratio)
        )
    return found


def _of_tree(who: str, runs: Sequence[CpuRun]) -> list[Headline]:
    if not runs:
        return []
    return [
        Headline(
            what="CPU of a session second, all processes",
            who=who,
            unit="s",
            value=median(run.cpu_s_per_s for run in runs),
        ),
        *(
            Headline(what=f"{VIDEO}, capture to display, {name}", who=who, unit="ms", value=value)
            for name, value in (
                ("p50", middle([run.video_p50_ms for run in runs])),
                ("p99", middle([run.video_p99_ms for run in runs])),
            )
        ),
    ]


def middle(values: Sequence[float | None]) -> float | None:
    """The median of those that are known; None if there is none."""
    known = [value for value in values if value is not None]
    return median(known) if known else None
