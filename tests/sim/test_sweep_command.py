"""Sessions in processes of their own, and `kontur-av sweep`."""

import csv
import json
import pickle
import subprocess
import sys
from contextlib import closing
from dataclasses import replace
from types import SimpleNamespace

import pytest

from kontur_av.errors import ConfigError
from pipelines.cli import main
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.virtual.campaign import sessions
from pipelines.virtual.campaign.campaign_metrics import Crash, SessionTask
from pipelines.virtual.campaign.sessions import run_session, run_sessions

TASK = SessionTask(setup=BUILT_IN["taskboard"], seconds=1.0, seed=1, media=False)


def test_closing_the_generator_ends_the_sessions():
    endless = replace(TASK, seconds=90_000.0)
    with closing(run_sessions([TASK, endless], jobs=2)) as runs:
        number, found = next(runs)
    assert (number, found.simulation.seed) == (0, 1)


def test_a_session_that_ended_early_counts_as_crashed(monkeypatch):
    def shorter(task):
        return pickle.dumps(replace(task, seconds=0.5))

    monkeypatch.setattr(sessions, "pickle", SimpleNamespace(dumps=shorter))
    with closing(run_sessions([TASK], jobs=1)) as runs:
        assert next(runs) == (0, Crash("ended early, after 0.5 s"))


def test_a_session_ends_when_who_started_it_has_died(tmp_path):
    report = tmp_path / "report.json"
    # The end of its input, as when the process at the other end is killed.
    command = [sys.executable, "-m", "pipelines.virtual.campaign.sessions", str(report)]
    endless = pickle.dumps(replace(TASK, seconds=90_000.0))
    done = subprocess.run(command, input=endless, timeout=60)
    assert done.returncode == 0
    assert json.loads(report.read_text())["seconds"] < 1


def test_a_setup_that_cannot_run_here_is_refused():
    setup = replace(TASK.setup, sources={TASK.setup.inputs[0]: "/nowhere/film.mp4"})
    with pytest.raises(ConfigError, match=r"/nowhere/film\.mp4"):
        run_session(replace(TASK, setup=setup))


SWEEP = """
seconds = 1
seeds = 2
media = false
figures = ["link.uplink.frames"]
[[grid]]
radio_delay_ms = [0, 20]
"""


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    """The folder of a sweep, with its file, its report, its rows and its chart."""
    folder = tmp_path_factory.mktemp("sweep")
    (folder / "mine.toml").write_text(SWEEP)
    assert main(command(folder)) == 0
    return folder


def command(folder):
    words = ["sweep", str(folder / "mine.toml"), "--report", str(folder / "mine.json")]
    return [*words, "--csv", str(folder / "mine.csv"), "--plot", str(folder / "mine.png")]


def test_a_sweep_has_every_case_and_every_run(swept):
    report = json.loads((swept / "mine.json").read_text())
    assert [case["values"] for case in report["cases"]] == [
        {"radio_delay_ms": 0},
        {"radio_delay_ms": 20},
    ]
    found = [case["metrics"]["force_p99_ms"]["median"] for case in report["cases"]]
    assert found[1] - found[0] == 20
    assert [run["seed"] for run in report["runs"]] == [1, 2, 1, 2]
    rows = list(csv.DictReader((swept / "mine.csv").open()))
    assert [row["link.uplink.frames"] for row in rows] == ["1000"] * 4
    assert (swept / "mine.png").read_bytes().startswith(b"\x89PNG")


def test_a_sweep_runs_only_what_its_report_lacks(swept, capsys):
    marked = json.loads((swept / "mine.json").read_text())
    marked["runs"][1]["metrics"]["force_p99_ms"] = 777.0
    del marked["runs"][2]
    # A run that crashed is done again.
    marked["runs"][2]["error"] = "killed"
    (swept / "marked.json").write_text(json.dumps(marked))
    words = [word.replace("mine.json", "marked.json") for word in command(swept)]
    assert main(words) == 0
    told = capsys.readouterr()
    assert "2 of 4 runs" in told.err
    assert "4 of 4 runs" in told.err
    kept = [
        run["metrics"]["force_p99_ms"]
        for run in json.loads((swept / "marked.json").read_text())["runs"]
    ]
    assert kept[1] == 777.0
    assert kept[2:] == [21, 21]


def test_a_report_of_another_kind_is_refused_in_one_line(swept, capsys):
    (swept / "other.json").write_text("{}")
    words = [word.replace("mine.json", "other.json") for word in command(swept)]
    assert main(words) == 2
    error = capsys.readouterr().err
    assert "is no report of this version's `sweep`" in error
    assert error.count("\n") == 1


def test_sessions_with_a_plan_are_judged_by_their_tasks(tmp_path, capsys):
    plan, file, kept = tmp_path / "plan.toml", tmp_path / "tasks.toml", tmp_path / "r.json"
    plan.write_text('skill = 1.0\n[[task]]\nname = "aiming"\n')
    words = 'seconds = 36\nmedia = false\nplan = "plan.toml"\n[[grid]]\nradio = "clean"\n'
    file.write_text(words)
    assert main(["sweep", str(file), "--report", str(kept)]) == 0
    assert "1 of 1 usable" in capsys.readouterr().out
    report = json.loads(kept.read_text())
    (run,) = report["runs"]
    assert run["metrics"]["tasks_finished"] == 1
    assert run["metrics"]["aiming_s"] > 1
    assert report["headlines"][0]["met"]
    plan.write_text('[[task]]\nname = "nothing"\n')
    assert main(["sweep", str(file)]) == 2
    assert "nothing" in capsys.readouterr().err
