"""What is kept of each run of `python -m benchmarks all`: a small JSON file a run."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec

from benchmarks.machine import Machine
from kontur_av.errors import ConfigError
from pipelines.report.report_file import write_report
from pipelines.report.result import Headline, as_json


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """What every bench reports."""

    headlines: tuple[Headline, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Record:
    """One run. number: from 1. date: UTC, ISO 8601. code: digest of the code that ran.

    failure: the last words of a command that did not exit with 0; else empty.
    """

    name: str
    title: str
    command: str
    number: int
    date: str
    code: str
    machine: Machine
    failure: str
    headlines: tuple[Headline, ...]


def path_of(directory: Path, name: str, number: int) -> Path:
    """Where the record of a run is kept."""
    return directory / f"{name}-{number}.json"


def write_record(directory: Path, record: Record) -> None:
    """Keep `record` in `directory`."""
    body = as_json(record)
    assert isinstance(body, dict)
    write_report(path_of(directory, record.name, record.number), body)


def read_record(path: Path) -> Record:
    """The record of a file. ConfigError if it holds none."""
    try:
        return msgspec.json.decode(path.read_bytes(), type=Record)
    except (OSError, msgspec.MsgspecError) as error:
        raise ConfigError(f"{path}: no record of `benchmarks all` ({error})") from None


def read_records(directory: Path, names: Sequence[str]) -> list[Record]:
    """All records in `directory`, in the order of `names` and of their numbers."""
    found = [read_record(path) for path in sorted(directory.glob("*-*.json"))]
    known = [record for record in found if record.name in names]
    return sorted(known, key=lambda record: (names.index(record.name), record.number))
