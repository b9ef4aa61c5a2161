"""A session's report as metrics of Prometheus. A core.

The name of a metric is the way to its key in the report, with `_` for dots; units are those of
Prometheus, seconds and bytes. A table in the report becomes a label:
`streams.uplink_video.stale_ns` is `kontur_stream_stale_seconds_total{stream="uplink_video"}`, and
`link.uplink.drops.full` is `kontur_link_drops_total{direction="uplink", drops="full"}`. What
adds up over the starts of a process is a counter, all else a gauge. A text is a label of a gauge of
1. Lists are left out.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import is_dataclass
from functools import cache
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin, get_type_hints

import msgspec
from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric

from kontur_av.metrics import is_flat, marks_of
from pipelines.report.model import SessionReport

#: By table of the report: how its metrics begin, and the label of its rows.
_TABLES = {
    "streams": ("stream", "stream"),
    "haptic": ("haptic", "direction"),
    "link": ("link", "direction"),
    "gateways": ("gateway", "end"),
    "processes": ("process", "process"),
    "skew_ms": ("skew_ms", "between"),
}
#: Counted, although a report declares them.
_COUNTED = {"restarts", "counts"}
#: Words that Prometheus has for something else.
_WORDS = {"count": "values", "total": "whole", "bits_flipped": "flips"}
#: By unit at the end of a word: that of Prometheus, and how many make one of it.
_UNITS = {
    "ns": ("seconds", 1e9),
    "us": ("seconds", 1e6),
    "ms": ("seconds", 1e3),
    "s": ("seconds", 1.0),
    "octets": ("bytes", 1.0),
}
_ANY = "*"
#: Sentences with numbers in them, of which each would be a series of its own.
_SENTENCES = {"path_why", "reason", "advice"}
_Path = tuple[str, ...]
_COUNTS: _Path = ("processes", _ANY, "counts")


class Exposition:
    """What is exposed. Set `report`, the decoded JSON of a report, and `problems`."""

    def __init__(self) -> None:
        self.report: Mapping[str, Any] = {}
        self.problems: Sequence[str] = ()
        self._registry = CollectorRegistry(auto_describe=False)
        self._registry.register(self)

    def text(self) -> bytes:
        """Return all metrics in the text format 0.0.4."""
        return generate_latest(self._registry)

    def collect(self) -> Iterator[Metric]:
        """For the registry."""
        families: dict[str, GaugeMetricFamily | CounterMetricFamily] = {}
        for key, value in self.report.items():
            name, label = _TABLES.get(key, (key, ""))
            rows = value.items() if label and isinstance(value, Mapping) else [("", value)]
            for row, below in rows:
                labels = {label: row} if label else {}
                path = (key, _ANY) if label else (key,)
                for found in _leaves(below, path, name, labels):
                    _add(families, *found)
        healthy = GaugeMetricFamily("kontur_healthy", "Whether /healthz answers 200.")
        healthy.add_metric((), float(not self.problems))
        yield healthy
        yield from families.values()


def _leaves(
    value: Any, path: _Path, name: str, labels: Mapping[str, str]
) -> Iterator[tuple[_Path, str, Mapping[str, str], float]]:
    """Each number below `value`: its path with `*` for a row of a table, name, labels, value."""
    if isinstance(value, Mapping):
        table = _kinds().get(path) == "table"
        for key, below in value.items():
            row = (*path, _ANY if table else key)
            # A process counts what it likes: each has a name of its own.
            if table and path != _COUNTS:
                label = f"{path[-2]}_kind" if path[-1] == _ANY else path[-1]
                yield from _leaves(below, row, name, {**labels, label: key})
            else:
                yield from _leaves(below, row, f"{name}.{key}", labels)
    elif isinstance(value, str) and path[-1] not in _SENTENCES:
        yield path, name, {**labels, path[-1]: value}, 1.0
    elif isinstance(value, int | float):
        yield path, name, labels, float(value)


def _add(
    families: dict[str, GaugeMetricFamily | CounterMetricFamily],
    path: _Path,
    name: str,
    labels: Mapping[str, str],
    value: float,
) -> None:
    name, per_unit = _named(name)
    family = families.get(name)
    if family is None:
        kind = CounterMetricFamily if _kinds().get(path) == "counter" else GaugeMetricFamily
        words = f"{'.'.join(path)} of the report (docs/report.md)."
        family = families[name] = kind(name, words, labels=list(labels))
    family.add_metric(list(labels.values()), value / per_unit)


@cache
def _named(way: str) -> tuple[str, float]:
    """The name of a metric, and how many units of the report make one of its own."""
    words, unit, per_unit = ["kontur"], "", 1.0
    for key in way.split("."):
        *before, last = _WORDS.get(key, re.sub(r"\W", "_", key)).split("_")
        words += before
        if last in _UNITS:
            unit, per_unit = _UNITS[last]
        else:
            words.append(last)
    if words[-1] == _WORDS["count"]:
        unit, per_unit = "", 1.0
    return "_".join([*words, unit] if unit else words), per_unit


@cache
def _kinds() -> Mapping[_Path, str]:
    return dict(_declared(SessionReport, ()))


def _declared(kind: Any, path: _Path) -> Iterator[tuple[_Path, str]]:
    """Where the report has counters and tables, from the types of its fields."""
    hints = get_type_hints(kind, include_extras=True)
    fields = msgspec.structs.fields(kind) if issubclass(kind, msgspec.Struct) else ()
    names = {one.name: one.encode_name for one in fields}
    for field, marks in marks_of(kind).items():
        below = path if is_flat(kind, field) else (*path, names.get(field, field))
        counted = field in _COUNTED or (is_dataclass(kind) and not marks)
        for hint in _plain(hints[field]):
            # The rows of a flat table are figures of what holds it.
            if below != path or not isinstance(get_origin(hint), type):
                yield from _below(hint, below, counted)


def _below(hint: Any, path: _Path, counted: bool) -> Iterator[tuple[_Path, str]]:
    if hint is int and counted:
        yield path, "counter"
    elif isinstance(get_origin(hint), type) and issubclass(get_origin(hint), Mapping):
        yield path, "table"
        for row in _plain(get_args(hint)[1]):
            yield from _below(row, (*path, _ANY), counted)
    elif is_dataclass(hint) or (isinstance(hint, type) and issubclass(hint, msgspec.Struct)):
        yield from _declared(hint, path)


def _plain(hint: Any) -> Iterator[Any]:
    """The types of a hint without marks; of a union each."""
    if get_origin(hint) is Annotated:
        yield from _plain(get_args(hint)[0])
    elif get_origin(hint) in (Union, UnionType):
        for arg in get_args(hint):
            yield from _plain(arg)
    else:
        yield hint
