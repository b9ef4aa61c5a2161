"""Tests that need the machine run one at a time, before the others, and once more if they fail.

Checked with pytest itself, on a small suite in a temporary directory.
"""

import re
import subprocess
import sys

import pytest
from places import ROOT

#: How pytest's closing line ends.
IN_TIME = r"in [\d.]+s( \([\d:]+\))?"
#: Each test leaves a line when it begins and when it ends; `unsteady` fails once.
WATCHED = """
import os, time
import pytest

yielded = []

def pytest_configure():
    # The suite itself may have the lowest priority already.
    import serial_tests
    serial_tests.yield_the_machine = lambda: yielded.append(1)

@pytest.fixture(autouse=True)
def watched(request):
    with open(os.environ["TRACE"], "a") as trace:
        print("begin", request.node.nodeid, os.getpid(), file=trace, flush=True)
        yield
        print("end", request.node.nodeid, len(yielded) > 0, file=trace, flush=True)

@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return []
"""
QUICK = """
import pytest, time

@pytest.mark.parametrize("number", range(9))
def test_quick(number):
    time.sleep(0.02 * number)
"""
SERIAL = """
import os, pathlib, time

def test_slow():
    time.sleep(0.1)

def test_fails_once(made):
    made.append(1)
    first = not pathlib.Path(os.environ["MARK"]).exists()
    pathlib.Path(os.environ["MARK"]).touch()
    print("what it printed")
    assert len(made) == 1, "the second run has the fixtures of the first"
    assert not first, "the first time"

def test_slow_again():
    time.sleep(0.1)
"""
SLOW = """
import time

def test_slow():
    time.sleep(1)

def test_slow_again():
    time.sleep(1)

def test_slow_once_more():
    time.sleep(1)
"""
BESIDE = """
def test_waits():
    pass
"""
TWICE = """
def test_fails_twice():
    print("printed", "both times", sep=": ")
    assert False, "each time"
"""


@pytest.fixture
def run(tmp_path, monkeypatch):
    """run({room: source}, *options): exit code, output, and what began and ended, in order."""

    def run_suite(rooms, *options):
        (tmp_path / "pytest.ini").write_text("[pytest]\n")
        (tmp_path / "tests").mkdir()
        conftest = 'pytest_plugins = ("serial_tests",)\n'
        (tmp_path / "tests" / "conftest.py").write_text(conftest + WATCHED)
        for room, source in rooms.items():
            (tmp_path / "tests" / room).mkdir()
            (tmp_path / "tests" / room / f"test_{room}.py").write_text(source)
        trace = tmp_path / "trace"
        monkeypatch.setenv("TRACE", str(trace))
        monkeypatch.setenv("MARK", str(tmp_path / "mark"))
        monkeypatch.delenv("PYTEST_ADDOPTS", raising=False)
        helpers = f"pythonpath={ROOT / 'tests' / 'helpers'}"
        python = [sys.executable, "-m", "pytest", "-q", "-o", helpers, "--dist", "load"]
        done = subprocess.run(
            [*python, "--no-loadscope-reorder", *options, "tests"],
            capture_output=True,
            text=True,
            cwd=tmp_path,
            timeout=120,
        )
        events = [line.split() for line in trace.read_text().splitlines()]
        return done.returncode, done.stdout, events

    return run_suite


@pytest.mark.parametrize("workers", ["0", "2"])
def test_serial_tests_run_one_at_a_time_and_an_unsteady_one_is_named(run, tmp_path, workers):
    rooms = {"browser": SERIAL, "interop": BESIDE, "quick": QUICK}
    code, output, events = run(rooms, "-n", workers, "--unsteady", str(tmp_path / "kept.txt"))

    assert code == 0, output
    name = "tests/browser/test_browser.py::test_fails_once"
    *_, named, closing = output.splitlines()
    assert named == f"UNSTEADY {name}"
    assert re.fullmatch(rf"13 passed, 1 unsteady {IN_TIME}", closing)
    for text in (output, (tmp_path / "kept.txt").read_text()):
        assert "the first time" in text and "what it printed" in text
    serial = [(what, test) for what, test, _ in events if "browser" in test]
    assert [what for what, _ in serial] == ["begin", "end"] * 4
    assert [test for _, test in serial].count(name) == 4


def test_only_quick_tests_run_beside_the_serial_ones_and_leave_them_the_machine(run):
    code, output, events = run({"browser": SLOW, "interop": BESIDE, "quick": QUICK}, "-n", "2")

    assert code == 0, output
    workers = {test: pid for what, test, pid in events if what == "begin"}
    (alone,) = {workers[test] for test in workers if "browser" in test}
    assert workers["tests/interop/test_interop.py::test_waits"] != alone
    yielded = {test: text for what, test, text in events if what == "end"}
    assert {text for test, text in yielded.items() if "quick" in test} == {"True"}
    assert {text for test, text in yielded.items() if "quick" not in test} == {"False"}


def test_a_serial_test_that_fails_twice_fails_with_the_output_of_both_runs(run):
    code, output, _events = run({"realtime": TWICE, "quick": QUICK}, "-n", "2")

    assert code == 1
    assert "UNSTEADY" not in output
    assert output.count("printed: both times") == 2 and "First run" in output
    assert re.fullmatch(rf"1 failed, 9 passed {IN_TIME}", output.splitlines()[-1])


def test_a_test_that_does_not_need_the_machine_is_not_run_again(run):
    code, output, events = run({"quick": TWICE}, "-n", "0")

    assert code == 1
    assert len(events) == 2
    assert re.fullmatch(rf"1 failed {IN_TIME}", output.splitlines()[-1])
