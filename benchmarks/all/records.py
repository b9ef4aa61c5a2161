"""What is kept of each run of `python -m benchmarks all`: a small JSON file a run."""

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.json_reader import JsonReader
from benchmarks.machine import Machine
from kontur_av.errors import ConfigError
from pipelines.report.report_file import write_report
from pipelines.report.result import Headline, as_json


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
        found = JsonReader(json.loads(path.read_text(encoding="utf-8")), path.name)
        machine = found.at("machine")
        return Record(
            name=found.text("name"),
            title=found.text("title"),
            command=found.text("command"),
            number=round(found.number("number")),
            date=found.text("date"),
            code=found.text("code"),
            machine=Machine(
                cpu=machine.text("cpu"),
                cores=round(machine.number("cores")),
                kernel=machine.text("kernel"),
                python=machine.text("python"),
                pyav=machine.text("pyav"),
            ),
            failure=found.text("failure"),
            headlines=tuple(read_headlines(found)),
        )
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path}: no record of `benchmarks all` ({error})") from None


def read_headlines(report: JsonReader) -> Iterable[Headline]:
    """The headlines in the report of a bench. ValueError if there are none."""
    for found in report.elements("headlines"):
        met = found.at("met").value
        yield Headline(
            group=found.text("group"),
            what=found.text("what"),
            who=found.text("who"),
            unit=found.text("unit"),
            value=found.number_or_none("value"),
            target=found.text("target"),
            met=met if isinstance(met, bool) else None,
        )


def read_records(directory: Path, names: Sequence[str]) -> list[Record]:
    """All records in `directory`, in the order of `names` and of their numbers."""
    found = [read_record(path) for path in sorted(directory.glob("*-*.json"))]
    known = [record for record in found if record.name in names]
    return sorted(known, key=lambda record: (names.index(record.name), record.number))
