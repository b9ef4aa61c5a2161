"""Limits of values, and the events of leaving and keeping them."""

import pytest
from pus_ends import oven_table

from telepresence.tmtc.pus.dictionary_file import dictionary_from_table
from telepresence.tmtc.pus.monitoring import LimitMonitors


@pytest.fixture
def check():
    table = oven_table()
    table["oven"]["event"]["cold"] = {"number": 3, "severity": "low"}
    table["oven"]["monitor"]["heat"].update(low=10.0, low_clear=20.0, below="cold")
    monitors = LimitMonitors(dictionary_from_table(table).application("oven"))

    def run(*values):
        return ["".join(monitors.handle_values({"temperature": value})) for value in values]

    run.monitors = monitors
    return run


def test_limits_are_left_for_a_while_and_a_value_on_them_is_within(check):
    assert check(10.0, 10.0, 220.0, 220.0) == [""] * 4
    assert check(9.9, 9.9, 15.0, 15.0, 20.0, 20.0) == ["", "cold", "", "", "", "cooled"]
    assert check(220.1, 230.0, 200.0, 200.0, 180.0, 180.0) == ["", "too_hot", *[""] * 3, "cooled"]
    # Each event needs its checks in a row.
    assert check(230.0, 100.0, 230.0, 230.0) == ["", "", "", "too_hot"]


def test_a_monitor_that_is_switched_on_again_begins_within_its_limits(check):
    assert check(230.0, 230.0) == ["", "too_hot"]
    check.monitors.set_on(1, on=False)
    assert check(100.0, 100.0) == ["", ""]
    check.monitors.set_on(1, on=True)
    assert check(230.0, 230.0) == ["", "too_hot"]
