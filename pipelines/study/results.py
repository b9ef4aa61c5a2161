"""The files of a study: its plan, its trials as they finish, its tables. A shell."""

import csv
import fcntl
import hashlib
import io
import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import astuple, fields
from importlib.util import find_spec
from pathlib import Path

import msgspec
import numpy as np

from kontur_av.closing import Closing
from kontur_av.errors import ConfigError, refused
from pipelines.recording.export.columns import Column
from pipelines.recording.export.table_files import write_v5
from pipelines.report.report_file import write_text
from pipelines.study.effects import StudyReport, account_of_study
from pipelines.study.plan import StudyPlan, TrialResult
from telepresence.toml_file import read_toml, typed

_FILE = "trials.jsonl"
_NAMES = tuple(field.name for field in fields(TrialResult))


class _Head(msgspec.Struct, frozen=True, kw_only=True):
    """The first line of the trials: of which study they are. digest: of its plan. by: whom."""

    study: str
    digest: str
    by: str


def load_study(path: Path) -> StudyPlan:
    """The plan in a file. ConfigError names file and mend."""
    table = read_toml(path, "study")
    with refused(f"study {path}", ConfigError):
        return typed(table, StudyPlan, "a study")


def check_scipy() -> None:
    """ConfigError without what effects are computed with."""
    if find_spec("scipy") is None:
        raise ConfigError("the effects need scipy: pip install 'kontur-av[study]'")


class StudyFolder(Closing):
    """The folder of a study's results, held by one command at a time. ConfigError.

    results: of all trials that have finished. simulated: they are of simulated hands, and those
    that are there are thrown away.
    """

    def __init__(self, path: Path, plan: StudyPlan, *, simulated: bool = False) -> None:
        self._path = path / _FILE
        digest = hashlib.sha256(msgspec.json.encode(plan)).hexdigest()[:16]
        by = "simulated hands" if simulated else "people"
        head = _Head(study=plan.name, digest=digest, by=by)
        try:
            path.mkdir(parents=True, exist_ok=True)
            self._file = self._path.open("a+b")
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ConfigError(f"{path}: another command has this study: end it first") from None
        except OSError as error:
            raise ConfigError(f"{path}: cannot be written: {error.strerror or error}") from None
        self.results = self._read(head, fresh=simulated)
        if self._file.seek(0, os.SEEK_END) == 0:
            self._append(msgspec.json.encode(head))

    def close(self) -> None:
        self._file.close()

    @property
    def finished(self) -> Counter[int]:
        """How many trials of each participant have finished."""
        return Counter(one.participant for one in self.results)

    def add(self, result: TrialResult) -> None:
        """Keep a trial; it is on the disk when this returns."""
        self.results.append(result)
        self._append(msgspec.json.encode(result))

    def _append(self, line: bytes) -> None:
        self._file.write(line + b"\n")
        self._file.flush()
        os.fsync(self._file.fileno())

    def _read(self, head: _Head, *, fresh: bool) -> list[TrialResult]:
        self._file.seek(0)
        octets = self._file.read()
        # A line that was being written when the power failed is no trial.
        whole = octets.rfind(b"\n") + 1
        self._file.truncate(whole)
        lines = octets[:whole].splitlines()
        if not lines:
            return []
        try:
            found = msgspec.json.decode(lines[0], type=_Head)
            results = [msgspec.json.decode(line, type=TrialResult) for line in lines[1:]]
        except msgspec.DecodeError as error:
            raise ConfigError(f"{self._path}: no trials of a study ({error})") from None
        if found.by != head.by:
            raise ConfigError(f"{self._path} is of {found.by}: name another folder by --results")
        if fresh:
            self._file.truncate(0)
            return []
        if found != head:
            raise ConfigError(
                f"{self._path} is of study {found.study} with another plan: take the plan that it "
                "was made with, or another folder by --results"
            )
        return results


def write_tables(path: Path, results: Sequence[TrialResult], report: StudyReport) -> list[Path]:
    """Write trials and effects as CSV and as one MATLAB file, and the account; their paths."""
    trials = [_NAMES, *(astuple(one) for one in results)]
    names = tuple(field.name for field in fields(report.effects[0])) if report.effects else ()
    effects = [names, *(astuple(one) for one in report.effects)]
    found = [path / name for name in ("trials.csv", "effects.csv", "study.mat", "report.html")]
    with refused(f"{path}: cannot be written"):
        for file, table in zip(found, (trials, effects), strict=False):
            text = io.StringIO()
            csv.writer(text).writerows(table)
            write_text(file, text.getvalue())
        write_v5(found[2], {"trials": _columns(results)})
        write_text(found[3], account_of_study(report))
    return found


def _columns(results: Sequence[TrialResult]) -> dict[str, Column]:
    """A column for each field; NaN where a trial has no such figure."""
    found: dict[str, Column] = {}
    for name in _NAMES:
        values = [getattr(one, name) for one in results]
        texts = values if all(isinstance(one, str) for one in values) else None
        found[name] = np.array(values, np.float64) if texts is None else texts
    return found
