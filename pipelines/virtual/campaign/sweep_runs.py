"""Does the runs of a sweep that are missing in its report, and keeps them there. A shell."""

import argparse
import json
from collections.abc import Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from time import monotonic

import msgspec

from kontur_av.errors import ConfigError
from pipelines.report.report_file import write_result
from pipelines.virtual.campaign.figures import Crash, RunFigures, crashed, run_figures
from pipelines.virtual.campaign.places import cluster_of, code_digest
from pipelines.virtual.campaign.sessions import Progress, session_results
from pipelines.virtual.campaign.sweep import Sweep, case_figures, headlines, task_key

#: The runs that are over are kept this often.
_KEEP_EVERY_S = 5.0


def run_missing(
    args: argparse.Namespace, sweep: Sweep, runs: list[RunFigures | None], jobs: int
) -> None:
    """Put the figures of each run that is missing into `runs`, and keep them now and then."""
    tasks = sweep.tasks()
    missing = [number for number, run in enumerate(runs) if run is None]
    progress = Progress(len(runs), "runs")
    with ExitStack() as stack:
        cluster = stack.enter_context(cluster_of(args))
        wanted = [tasks[number] for number in missing]
        results = stack.enter_context(closing(session_results(wanted, jobs=jobs, cluster=cluster)))
        stack.callback(_keep, args.report, sweep, runs)
        kept_s = monotonic()
        progress.told(len(runs) - len(missing))
        for count, (place, result) in enumerate(results, 1 + len(runs) - len(missing)):
            task = tasks[missing[place]]
            key = task_key(task, sweep.keys, code_digest())
            runs[missing[place]] = (
                crashed(task, key, result)
                if isinstance(result, Crash)
                else run_figures(task, key, result, sweep.keys)
            )
            progress.told(count)
            if monotonic() - kept_s >= _KEEP_EVERY_S:
                _keep(args.report, sweep, runs)
                kept_s = monotonic()


def _keep(path: Path | None, sweep: Sweep, runs: Sequence[RunFigures | None]) -> None:
    cases = case_figures(sweep, runs)
    body = {
        "seconds": sweep.seconds,
        "media": sweep.media,
        "cases": cases,
        "runs": [run for run in runs if run is not None],
    }
    write_result(path, body, headlines(sweep, cases))


def kept_runs(path: Path | None, sweep: Sweep) -> list[RunFigures | None]:
    """Each run of a sweep, as the report of an earlier one has it; None: crashed, or not there."""
    tasks = sweep.tasks()
    if path is None or not path.is_file() or not path.stat().st_size:
        return [None] * len(tasks)
    try:
        runs = msgspec.convert(
            json.loads(path.read_text(encoding="utf-8"))["runs"], list[RunFigures]
        )
    except (ValueError, KeyError, TypeError):
        raise ConfigError(
            f"--report {path}: is no report of this version's `sweep`; name another file"
        ) from None
    kept = {run.key: run for run in runs if not run.error}
    return [kept.get(task_key(task, sweep.keys, code_digest())) for task in tasks]
