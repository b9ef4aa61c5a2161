"""Tiers and lanes, checked with pytest itself on a small suite in a temporary directory."""

import re
import subprocess
import sys

import pytest
from positions import ROOT
from tiers import TABLE

#: Leaves a line for each test: when it begins and ends, in which process, at which priority.
CONFTEST = """
import os
import pytest

pytest_plugins = ("tiers",)

@pytest.fixture(autouse=True)
def watched(request):
    with open(os.environ["TRACE"], "a") as trace:
        print("begin", request.node.nodeid, os.getpid(), file=trace, flush=True)
        yield
        nice = os.getpriority(os.PRIO_PROCESS, 0)
        print("end", request.node.nodeid, nice, file=trace, flush=True)
"""
QUICK = """
import time, pytest

@pytest.mark.parametrize("number", range(6))
def test_quick(number):
    time.sleep(0.02)
"""
SLOW = """
import time, pytest

@pytest.mark.parametrize("number", range(3))
def test_slow(number):
    time.sleep(0.3)
"""
LACKS = """
import pytest

def test_lacks():
    pytest.skip("gnuplot: apt-get install gnuplot")

def test_cannot():
    pytest.skip("this machine has no radio")
"""


@pytest.fixture
def run(tmp_path, monkeypatch):
    """run({room: source}, *options): exit code, lines of output, and what began and ended."""

    def run_suite(rooms, *options):
        (tmp_path / "pytest.ini").write_text("[pytest]\n")
        for room, source in rooms.items():
            (tmp_path / "tests" / room).mkdir(parents=True)
            (tmp_path / "tests" / room / "test_it.py").write_text(source)
        (tmp_path / "tests" / "conftest.py").write_text(CONFTEST)
        trace = tmp_path / "trace"
        monkeypatch.setenv("TRACE", str(trace))
        monkeypatch.delenv("PYTEST_ADDOPTS", raising=False)
        monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")
        command = [sys.executable, "-m", "pytest", "-q", "-p", "xdist", "-n", "auto"]
        command += ["--import-mode=importlib"]
        command += ["-o", f"pythonpath={ROOT / 'tests' / 'helpers'}", "--no-loadscope-reorder"]
        done = subprocess.run(
            [*command, *options], capture_output=True, text=True, cwd=tmp_path, timeout=120
        )
        events = [line.split() for line in trace.read_text().splitlines()]
        return done.returncode, done.stdout.splitlines(), events

    return run_suite


def test_the_default_tier_says_what_it_left_out_and_what_is_missing(run):
    code, lines, events = run({"unit": QUICK, "realtime": SLOW, "fuzz": LACKS})
    assert code == 0
    assert lines[-1] == "6 passed; 3 live tests not run: pytest --full"
    assert "1 test: gnuplot: apt-get install gnuplot" in lines
    assert not any("realtime" in test for _, test, _ in events)

    # A file that the command line names runs in any tier; the rest of the full tier is the rest.
    for options in (("tests/realtime/test_it.py",), ("--full", "--skip-default", "-n", "0")):
        code, lines, _ = run({}, *options)
        assert code == 0
        assert re.match("3 passed", lines[-1])


def test_the_full_tier_runs_all_in_lanes_that_leave_each_other_the_machine(run):
    programs = SLOW.replace("(3)", "(10)").replace("0.3", "0.1")
    rooms = {"browser": SLOW, "realtime": SLOW, "interop": programs, "unit": QUICK, "fuzz": LACKS}
    code, lines, events = run(rooms, "--full")
    assert code == 1
    assert re.match("1 failed, 22 passed, 1 skipped in", lines[-1])
    assert any("the full tier skips nothing: gnuplot" in line for line in lines)
    begun = {test: pid for what, test, pid in events if what == "begin"}
    workers = {room: {pid for test, pid in begun.items() if room in test} for room in rooms}
    assert len(workers["browser"]) == 1 and workers["browser"] == workers["realtime"]
    assert len(workers["interop"]) == 1 and workers["interop"] != workers["browser"]
    # What has the machine alone comes last in its lane, and has no other lane beside it.
    lane = [test.split("/")[1] for test in begun if "browser" in test or "realtime" in test]
    assert lane == ["realtime"] * 3 + ["browser"] * 3
    running = set()
    for what, test, _ in events:
        if "unit" in test or "fuzz" in test:
            continue
        running = running | {test} if what == "begin" else running - {test}
        assert len(running) == 1 or not any("browser" in test for test in running)
    nice = {room: {n for what, t, n in events if what == "end" and room in t} for room in rooms}
    assert nice["unit"] == {"19"}
    # Those of the lanes keep the priority that pytest was started with.
    assert nice["browser"] == nice["interop"]


def test_each_row_of_the_table_has_tests():
    for row in TABLE:
        place, _, name = row.where.partition("::")
        found = list(ROOT.glob(f"{place}*"))
        assert found, row.where
        name = name.partition("[")[0]
        assert not name or f"def {name}" in found[0].read_text(encoding="utf-8"), row.where
