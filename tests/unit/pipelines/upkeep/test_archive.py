"""Reports of many sessions in one file, and how a figure went."""

import os
import sqlite3

import pytest
from partial_report import partial_report

from pipelines.cli import main
from pipelines.report.report_file import write_report

DAY_S = 86_400
EXERCISES = [{"at_ns": 2_000_000_000, "what": "los"}, {"at_ns": 3_000_000_000, "what": "end"}]


@pytest.fixture
def reports(tmp_path):
    """Three sessions, a day apart, of which the first had an exercise and a failure."""
    paths = []
    for day, seconds in enumerate((10.0, 20.0, 15.0)):
        told = {"streams": {}, "seconds": seconds}
        if day == 0:
            told |= {"exercises": EXERCISES, "failures": ["uplink_video stopped"]}
        path = tmp_path / f"day{day}.json"
        write_report(path, partial_report(told))
        os.utime(path, (1.8e9 + day * DAY_S,) * 2)
        paths.append(path)
    return paths


def test_sessions_events_and_trends_are_kept(tmp_path, reports, capsys):
    base = tmp_path / "all.sqlite"
    # Not in their order, and one of them twice.
    assert main(["archive", str(base), "add", *map(str, reversed(reports))]) == 0
    assert main(["archive", str(base), "add", str(reports[0])]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == f"{reports[0]}: already there"
    assert main(["archive", str(base), "list"]) == 0
    listed = capsys.readouterr().out.splitlines()
    assert [line.split()[1] for line in listed] == ["day0:", "day1:", "day2:"]
    assert listed[0].endswith("spacejustin, 10 s, failures: 1")
    assert main(["archive", str(base), "events"]) == 0
    assert "trainer: los: 1, in 1 of the sessions" in capsys.readouterr().out
    plot = tmp_path / "trend.png"
    words = ["archive", str(base), "trend", "seconds", "cpu.*", "--plot", str(plot)]
    assert main(words) == 0
    rows = capsys.readouterr().out.splitlines()
    assert rows[0] == "seconds"
    assert [row.rsplit(" ", 1)[1] for row in rows[1:4]] == ["10", "20", "15"]
    assert plot.read_bytes().startswith(b"\x89PNG")
    # Other programs read it, too.
    with sqlite3.connect(base) as other:
        (most,) = other.execute("select max(value) from figure where key = 'seconds'").fetchone()
    assert most == 20.0


def test_one_bad_report_keeps_none(tmp_path, reports):
    base = tmp_path / "all.sqlite"
    bad = tmp_path / "bad.json"
    bad.write_text('{"setup": 3}')
    assert main(["archive", str(base), "add", str(reports[0]), str(bad)]) == 2
    assert main(["archive", str(base), "list"]) == 0
    with sqlite3.connect(base) as other:
        assert other.execute("select count(*) from session").fetchone() == (0,)


@pytest.mark.parametrize(
    ("name", "octets", "words"),
    [
        ("text.sqlite", b"no database at all, but long enough to look like one" * 40, "no archive"),
        ("none.sqlite", None, "no such file"),
        ("far/away.sqlite", None, "no such file"),
    ],
)
def test_what_is_no_archive_is_refused(tmp_path, name, octets, words, capsys):
    path = tmp_path / name
    if octets is not None:
        path.write_bytes(octets)
    assert main(["archive", str(path), "list"]) == 2
    assert words in capsys.readouterr().err


def test_another_programs_database_is_left_alone(tmp_path, reports, capsys):
    path = tmp_path / "other.sqlite"
    with sqlite3.connect(path) as other:
        other.execute("create table mine (x)")
    assert main(["archive", str(path), "add", str(reports[0])]) == 2
    assert "another program's database" in capsys.readouterr().err
    with sqlite3.connect(path) as other:
        assert other.execute("select name from sqlite_master").fetchall() == [("mine",)]


def test_an_archive_that_is_damaged_is_said_in_one_line(tmp_path, reports, capsys):
    base = tmp_path / "all.sqlite"
    assert main(["archive", str(base), "add", str(reports[0])]) == 0
    octets = bytearray(base.read_bytes())
    octets[4096:] = bytes(len(octets) - 4096)
    base.write_bytes(octets)
    assert main(["archive", str(base), "add", str(reports[1])]) == 2
    assert str(base) in capsys.readouterr().err


def test_an_unknown_figure_is_named(tmp_path, reports, capsys):
    base = tmp_path / "all.sqlite"
    assert main(["archive", str(base), "add", str(reports[0])]) == 0
    assert main(["archive", str(base), "trend", "nonsense"]) == 2
    assert "no figure nonsense" in capsys.readouterr().err
    assert main(["archive", str(base), "trend"]) == 2


def test_a_closed_folder_is_said_in_one_line(tmp_path, reports, capsys):
    base = tmp_path / "none" / "all.sqlite"
    assert main(["archive", str(base), "add", str(reports[0])]) == 2
    assert "no archive" in capsys.readouterr().err
