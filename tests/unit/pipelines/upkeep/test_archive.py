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
        paths.append(str(path))
    return paths


@pytest.fixture
def archive(capsys, tmp_path):
    """archive(words): exit code, lines of output, and what is said of mistakes."""

    def run(*words, base=tmp_path / "all.sqlite"):
        code = main(["archive", str(base), *words])
        told = capsys.readouterr()
        return code, told.out.splitlines(), told.err

    return run


def test_sessions_events_and_trends_are_kept(tmp_path, reports, archive):
    # Not in their order, and one of them twice.
    assert archive("add", *reversed(reports))[0] == 0
    assert archive("add", reports[0])[:2] == (0, [f"{reports[0]}: already there"])
    _, listed, _ = archive("list")
    assert [line.split()[1] for line in listed] == ["day0:", "day1:", "day2:"]
    assert listed[0].endswith("spacejustin, 10 s, failures: 1")
    assert "trainer: los: 1, in 1 of the sessions" in str(archive("events"))
    plot = tmp_path / "trend.png"
    code, rows, _ = archive("trend", "seconds", "cpu.*", "--plot", str(plot))
    assert (code, rows[0]) == (0, "seconds")
    assert [row.rsplit(" ", 1)[1] for row in rows[1:4]] == ["10", "20", "15"]
    assert plot.read_bytes().startswith(b"\x89PNG")
    code, _, error = archive("trend", "nonsense")
    assert code == 2 and "no figure nonsense" in error
    assert archive("trend")[0] == 2
    # Other programs read it, too.
    with sqlite3.connect(tmp_path / "all.sqlite") as other:
        (most,) = other.execute("select max(value) from figure where key = 'seconds'").fetchone()
    assert most == 20.0


def test_one_bad_report_keeps_none(tmp_path, reports, archive):
    bad = tmp_path / "bad.json"
    bad.write_text('{"setup": 3}')
    assert archive("add", reports[0], str(bad))[0] == 2
    assert archive("list")[:2] == (0, [])
    with sqlite3.connect(tmp_path / "all.sqlite") as other:
        assert other.execute("select count(*) from session").fetchone() == (0,)


def test_what_is_no_archive_is_refused_in_one_line_and_left_alone(tmp_path, reports, archive):
    text, foreign = tmp_path / "text.sqlite", tmp_path / "other.sqlite"
    text.write_bytes(b"no database at all, but long enough to look like one" * 40)
    with sqlite3.connect(foreign) as other:
        other.execute("create table mine (x)")
    for words, base, says in (
        (["list"], text, "no archive"),
        (["list"], tmp_path / "none.sqlite", "no such file"),
        (["list"], tmp_path / "far" / "away.sqlite", "no such file"),
        (["add", reports[0]], tmp_path / "none" / "all.sqlite", "no archive"),
        (["add", reports[0]], foreign, "another program's database"),
    ):
        code, _, error = archive(*words, base=base)
        assert code == 2 and says in error
    with sqlite3.connect(foreign) as other:
        assert other.execute("select name from sqlite_master").fetchall() == [("mine",)]
    base = tmp_path / "all.sqlite"
    assert archive("add", reports[0])[0] == 0
    base.write_bytes(base.read_bytes()[:4096].ljust(base.stat().st_size, b"\0"))
    code, _, error = archive("add", reports[1])
    assert code == 2 and str(base) in error
