"""A sweep as a TOML file describes it: its cases, each a setup of its own. A shell.

docs/simulation.md has an annotated file. A mistake is a ConfigError that names the field and the
fix.
"""

import argparse
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, closing
from copy import deepcopy
from dataclasses import dataclass, field
from itertools import product
from math import prod
from pathlib import Path
from time import monotonic
from typing import Any

import msgspec

from kontur_av.errors import ConfigError, refused
from pipelines.report.report_file import write_result
from pipelines.session.setup.composition import STEREO, STEREO_PAIR
from pipelines.session.setup.setup_file import setup_from_table, table_of_setup
from pipelines.session.setup.table import (
    GROUND_MIC,
    NO_RADIO,
    OPERATOR_CAMERA,
    OPERATOR_MIC,
    Setup,
)
from pipelines.virtual.campaign.campaign_metrics import Crash, RunMetrics, crashed, run_metrics
from pipelines.virtual.campaign.sessions import Progress, cluster_of, code_digest, session_results
from pipelines.virtual.campaign.sweep import Case, Sweep, Value, case_metrics, headlines, task_key
from telepresence.link.radio.profile_file import radio_from_table
from telepresence.tasks.plan import TaskWorld
from telepresence.tasks.task_files import load_plan
from telepresence.toml_file import read_toml, typed

_MOST_RUNS = 100_000
_MOST_SECONDS = 100_000
#: Fields of a grid that are not in a setup.
_SETUP, _RADIO_START = "setup", "radio_start_s"


@dataclass(frozen=True, kw_only=True)
class _Plot:
    x: str | None = None
    y: str | None = None


@dataclass(frozen=True, kw_only=True)
class _File:
    seconds: float
    grid: tuple[Mapping[str, Any], ...] = field(
        metadata={"like": "tables [[grid]], like radio_delay_ms = [0, 25]"}
    )
    setup: str = "spacejustin"
    seeds: int | tuple[int, ...] = field(
        default=1, metadata={"like": "a number of seeds or a list of them, like 5 or [1, 2]"}
    )
    media: bool = True
    plan: str | None = None
    figures: tuple[str, ...] = field(
        default=(), metadata={"like": 'a list of keys of a report, like ["link.uplink.frames"]'}
    )
    plot: _Plot = _Plot()


def load_sweep(path: Path) -> Sweep:
    """The sweep in a file; ConfigError."""
    table = read_toml(path, "sweep")
    with refused(f"sweep {path}", ConfigError):
        return _sweep(path, typed(table, _File, "a sweep"))


def _sweep(path: Path, file: _File) -> Sweep:
    if not 0 < file.seconds <= _MOST_SECONDS:
        raise ConfigError(f"seconds is {file.seconds:g}: take more than 0, at most {_MOST_SECONDS}")
    seeds = tuple(range(1, file.seeds + 1)) if isinstance(file.seeds, int) else file.seeds
    if not seeds or min(seeds) < 0 or len({*seeds}) < len(seeds):
        raise ConfigError(
            f"seeds is {file.seeds}: take a number of seeds from 1, or a list of different ones "
            "from 0"
        )
    if not file.grid:
        raise ConfigError("it has no [[grid]]: write one, like radio_delay_ms = [0, 25] in it")
    grids = [dict(_fields(grid, number)) for number, grid in enumerate(file.grid, 1)]
    runs = len(seeds) * sum(prod(map(len, grid.values())) for grid in grids)
    if runs > _MOST_RUNS:
        raise ConfigError(
            f"{runs} runs are too many: take fewer values or seeds, {_MOST_RUNS} in all"
        )
    found: dict[tuple[tuple[str, str], ...], Case] = {}
    for number, grid in enumerate(grids, 1):
        for chosen in product(*grid.values()):
            values = dict(zip(grid, chosen, strict=True))
            case = _case(file.setup, values, number)
            found.setdefault(tuple((name, str(value)) for name, value in case.values.items()), case)
    plan = None if file.plan is None else load_plan(path.parent / file.plan)
    if plan is not None:
        for case in found.values():
            plan[0].check(plan[1], TaskWorld(cameras=case.setup.cameras, setup=case.setup.name))
    sweep = Sweep(
        name=path.stem,
        seconds=file.seconds,
        seeds=seeds,
        media=file.media,
        plan=plan,
        cases=tuple(found.values()),
        fields=tuple(dict.fromkeys(name for grid in grids for name in grid)),
        keys=file.figures,
        x=file.plot.x,
        y=file.plot.y or ("video_p99_ms" if file.media else "force_p99_ms"),
    )
    if sweep.x is not None and sweep.x not in sweep.fields:
        raise ConfigError(f"plot.x is {sweep.x!r}: take one of {', '.join(sweep.fields)}")
    if sweep.y not in sweep.metrics:
        raise ConfigError(f"plot.y is {sweep.y!r}: take one of {', '.join(sweep.metrics)}")
    return sweep


def _fields(
    table: Mapping[str, object], number: int, prefix: str = ""
) -> Iterator[tuple[str, list[object]]]:
    """Dotted name and values of each field of a grid."""
    for key, value in table.items():
        name = prefix + key
        if isinstance(value, Mapping):
            yield from _fields(value, number, f"{name}.")
        elif isinstance(value, list):
            if not value:
                raise ConfigError(f"grid {number}: {name} is an empty list: give it a value")
            yield name, value
        else:
            yield name, [value]


def _case(setup: str, values: Mapping[str, object], number: int) -> Case:
    shown = {name: _shown(value) for name, value in values.items()}
    try:
        return Case(shown, _built(setup, values))
    except ConfigError as error:
        at = ", ".join(f"{name} = {value}" for name, value in shown.items())
        raise ConfigError(f"grid {number}, {at}: {error}") from None


def _built(setup: str, values: Mapping[str, object]) -> Setup:
    values = dict(values)
    setup = str(values.pop(_SETUP, setup))
    start_s = values.pop(_RADIO_START, None)
    if isinstance(start_s, bool) or not isinstance(start_s, int | float | None):
        raise ConfigError(f"{_RADIO_START} must be a number, not {start_s!r}")
    table = deepcopy(dict(table_of_setup(setup)))
    changes = {}
    radio = values.get("radio")
    if isinstance(radio, Mapping):
        # A radio in the place of a file's name: an inline table with a radio file's fields.
        changes["radio"] = radio_from_table({"name": _shown(radio), **radio}, Path())
        del values["radio"]
        table["radio"] = NO_RADIO
    if radio is not None and radio != NO_RADIO:
        # The base setup's delay belongs to its cable.
        table.pop("radio_delay_ms", None)
    sources = table.pop("sources", {})
    for name, value in values.items():
        _set(table, name, value)
    # The base setup's sources for inputs that this choice leaves out are left out, too.
    kept = {name: source for name, source in sources.items() if name in _inputs(table)}
    table["sources"] = {**kept, **table.get("sources", {})}
    return setup_from_table(table, changes=changes, radio_start_s=start_s)


def _inputs(table: Mapping[str, Any]) -> set[str]:
    others = {
        "uplink_voice": GROUND_MIC,
        "downlink_video": OPERATOR_CAMERA,
        "downlink_voice": OPERATOR_MIC,
    }
    # What is no list is refused when the setup is built.
    cameras = found if isinstance(found := table.get("cameras"), list | tuple) else ()
    names = {str(camera) for camera in cameras}
    composed = found if isinstance(found := table.get("composed"), Mapping) else {}
    made = {STEREO: {"compose": STEREO_PAIR.compose}, **composed}
    for name in names & made.keys():
        # As with cameras, another kind of value is refused when the setup is built.
        parts = found.get("compose") if isinstance(found := made[name], Mapping) else None
        names = names - {name} | {*map(str, parts if isinstance(parts, list | tuple) else ())}
    return names | {name for stream, name in others.items() if stream in table}


def _set(table: dict[str, object], name: str, value: object) -> None:
    """Put a value under a dotted name; `false` for a whole table leaves it out."""
    *folders, last = name.split(".")
    inner: Any = table
    for folder in folders:
        inner = inner.setdefault(folder, {})
        if not isinstance(inner, dict):
            raise ConfigError(f"{folder} has no fields of its own, so there is no {name}")
    if value is False and isinstance(inner.get(last), dict):
        del inner[last]
    else:
        inner[last] = value


def _shown(value: object) -> Value:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float | str):
        return value
    if isinstance(value, Mapping):
        if isinstance(value.get("name"), str):
            return str(value["name"])
        return " ".join(f"{key}={_shown(each)}" for key, each in value.items())
    if isinstance(value, list):
        return "+".join(str(_shown(each)) for each in value)
    return json.dumps(value, default=str)


#: The runs that are over are kept this often.
_KEEP_EVERY_S = 5.0


def run_missing(
    args: argparse.Namespace, sweep: Sweep, runs: list[RunMetrics | None], jobs: int
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
                else run_metrics(task, key, result, sweep.keys)
            )
            progress.told(count)
            if monotonic() - kept_s >= _KEEP_EVERY_S:
                _keep(args.report, sweep, runs)
                kept_s = monotonic()


def _keep(path: Path | None, sweep: Sweep, runs: Sequence[RunMetrics | None]) -> None:
    cases = case_metrics(sweep, runs)
    body = {
        "seconds": sweep.seconds,
        "media": sweep.media,
        "cases": cases,
        "runs": [run for run in runs if run is not None],
    }
    write_result(path, body, headlines(sweep, cases))


def kept_runs(path: Path | None, sweep: Sweep) -> list[RunMetrics | None]:
    """Each run of a sweep, as the report of an earlier one has it; None: crashed, or not there."""
    tasks = sweep.tasks()
    if path is None or not path.is_file() or not path.stat().st_size:
        return [None] * len(tasks)
    try:
        runs = msgspec.convert(
            json.loads(path.read_text(encoding="utf-8"))["runs"], list[RunMetrics]
        )
    except (ValueError, KeyError, TypeError):
        raise ConfigError(
            f"--report {path}: is no report of this version's `sweep`; name another file"
        ) from None
    kept = {run.key: run for run in runs if not run.error}
    return [kept.get(task_key(task, sweep.keys, code_digest())) for task in tasks]
