"""A figure that is declared once is in report, page, recording and documents."""

import typing
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum

import pytest
import report_keys as keys
from told import message, processes

from kontur_av.clock import NS_PER_S
from kontur_av.metrics import marks_of
from pipelines.recording.recorded_messages import RecordedFigure
from pipelines.report.collector import Collector
from pipelines.report.figures import figures_of
from pipelines.report.model import to_builtins
from pipelines.report.session_report import build_report
from pipelines.report.upkeep_now import UpkeepNow
from pipelines.session.session_metrics import TrainerMetrics
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.table import topology_of

SETUP = BUILT_IN["taskboard"]
#: Of the topology; each may tell any record.
PROCESSES = ("camera_left", "ground_gateway", "space_gateway")


def made(hint):
    """A value of a type, no number of it 0."""
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin is not None and type(None) in arguments:
        return made(arguments[0])
    kind = origin or hint
    if is_dataclass(kind):
        hints = typing.get_type_hints(kind)
        return kind(**{field.name: made(hints[field.name]) for field in fields(kind)})
    if issubclass(kind, Mapping):
        return {"some": made(arguments[1])} if arguments and arguments[1] is int else {}
    if issubclass(kind, Enum):
        return next(iter(kind))
    return {int: 7, float: 1.5, str: "text"}.get(kind, kind())


def names_of(kind):
    """The names of the numbers and texts of a record, and of the records in it."""
    hints = typing.get_type_hints(kind)
    for name in marks_of(kind):
        value = made(hints[name])
        if is_dataclass(value):
            yield from names_of(type(value))
        elif not isinstance(value, list | tuple | dict) or value:
            yield name


def told(record):
    """The report, and what pages are told, of a session whose processes have told a record."""
    collector = Collector(topology_of(SETUP))
    for process in PROCESSES:
        collector.handle_message(process, message(record), NS_PER_S)
    report = build_report(collector, seconds=1.0, processes=processes(PROCESSES), now_ns=NS_PER_S)
    tables = to_builtins(report)
    found = figures_of(tables, collector, UpkeepNow(collector), pass_s=0.0, now_ns=NS_PER_S)
    return tables, found


def parts_of(report):
    """All keys of a report, at any depth."""
    below = report.values() if isinstance(report, dict) else report
    found = set(report) if isinstance(report, dict) else set()
    return found.union(*(parts_of(one) for one in below if isinstance(one, dict | list)))


def is_among(name, keys_found):
    """A mapping such as `unknown_senders` has a name for each of its keys among the counts."""
    return name in keys_found or f"{name}_some" in keys_found


#: All but the record that has nothing but a list.
RECORDS = [kind for kind in keys.TOLD if kind is not TrainerMetrics]


@pytest.fixture(scope="module")
def documented():
    return keys.counts() + keys.report_keys()


@pytest.mark.rule("9")
@pytest.mark.parametrize("kind", RECORDS, ids=lambda kind: kind.__name__)
def test_each_figure_of_a_record_is_in_report_page_recording_and_documents(kind, documented):
    report, metrics = told(made(kind))
    reported = parts_of(report)
    on_page = {part for name in metrics for part in name.split(".")}
    recorded = {RecordedFigure.of(*figure).name for figure in metrics.items()}
    names = set(names_of(kind))
    assert names, "a record of figures"
    for name in names:
        assert is_among(name, reported), name
        assert is_among(name, on_page), name
        assert any(is_among(name, one.split(".")) for one in recorded), name
        assert f"`{name}`" in documented or f".{name}`" in documented, name
