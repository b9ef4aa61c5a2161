"""The common parts of benches: percentiles and JSON."""

import json
import math
from dataclasses import dataclass

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from pipelines.report.report_file import write_result
from pipelines.report.result import Headline, as_json, fitted_table, spread


@dataclass
class Inner:
    ratio: float
    names: tuple[str, ...]


@dataclass
class Outer:
    inner: Inner
    by_name: dict[str, Inner]


def test_a_spread_is_by_nearest_rank_a_result_is_json_and_columns_of_high_rank_go_first(tmp_path):
    found = spread([3e6, 1e6, 2e6, 4e6], per_unit=1e6)
    assert (found.p50, found.p95, found.p99, found.max) == (2.0, 4.0, 4.0, 4.0)
    assert math.isnan(spread([]).p50)
    inner = Inner(math.nan, ("a", "b"))
    body = {"ratio": None, "names": ["a", "b"]}
    assert as_json(Outer(inner, {"x": inner})) == {"inner": body, "by_name": {"x": body}}
    assert as_json(Inner(0.123456, ()), digits=2) == {"ratio": 0.12, "names": []}
    with pytest.raises(TypeError, match="object"):
        as_json(object())
    path = tmp_path / "r.json"
    write_result(path, Inner(1.5, ()), [Headline(what="x", unit="ms", value=2.0)])
    written = json.loads(path.read_text())
    assert written["ratio"] == 1.5
    assert written["headlines"][0]["value"] == 2.0
    write_result(None, Inner(1.5, ()), [])
    ranks, rows = {"name": 9, "keep": 1, "drop": 2}, [["abc", "1", "2"]]
    shown = [
        [column.header for column in fitted_table(ranks, rows, width).columns]
        for width in (22, 21, 1)
    ]
    assert shown == [["name", "keep", "drop"], ["name", "keep"], ["name"]]


@given(
    st.lists(st.tuples(st.integers(1, 12), st.integers(0, 9)), min_size=1, max_size=9),
    st.integers(20, 120),
)
def test_no_table_is_wider_than_its_width_or_cuts_a_cell(columns, width):
    ranks = {str(number): rank for number, (_, rank) in enumerate(columns)}
    table = fitted_table(ranks, [["x" * length for length, _ in columns]], width)
    console = Console(width=width)
    with console.capture() as capture:
        console.print(table)
    assert "…" not in capture.get()
    assert max(map(len, capture.get().splitlines())) <= width
    kept = capture.get().splitlines()[3]
    assert kept.count("x") == sum(len(next(iter(column.cells))) for column in table.columns)
