"""A report is read by its keys."""

import pytest

from benchmarks.json_reader import JsonReader


def test_a_report_is_read_by_its_keys_and_missing_ones_are_named():
    report = JsonReader({"a": {"b": 1.5, "c": None, "d": "text", "e": [1, 2]}})
    assert report.number("a", "b") == 1.5
    assert [one.number() for one in report.elements("a", "e")] == [1, 2]
    assert [name for name, _ in report.items("a")] == ["b", "c", "d", "e"]
    assert report.has("a", "b")
    assert not report.has("a", "c")
    assert not report.has("a", "z")
    for read in (
        lambda: report.number("a", "z"),
        lambda: report.number("a", "d"),
        lambda: list(report.items("a", "b")),
        lambda: list(report.elements("a", "d")),
    ):
        with pytest.raises(ValueError, match=r"report\.a"):
            read()
