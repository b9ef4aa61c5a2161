"""Tables and lines leave out columns and parts to fit a terminal, and cut nothing."""

from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from pipelines.report.result import fitted_line, fitted_table


def test_columns_of_the_highest_rank_go_first():
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


def test_parts_without_room_are_left_out_and_shorter_later_ones_stay():
    assert fitted_line(["first", "a long part", "end"], 12) == "first   end"
    assert fitted_line(["first", "second"], None, gap=", ") == "first, second"
    assert fitted_line(["first"], 1) == "first"
