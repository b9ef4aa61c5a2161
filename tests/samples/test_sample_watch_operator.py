"""samples/watch_operator.py reads the operator's display of the only running session."""

import re
import subprocess
import sys

from places import ROOT
from running_session import RunningSession

SAMPLE = ROOT / "samples" / "watch_operator.py"


def watch(environment=None, *arguments):
    command = [sys.executable, str(SAMPLE), *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, env=environment)


def test_watch_operator(tmp_path):
    with RunningSession("taskboard", directory=tmp_path) as session:
        session.wait_for_flow(["uplink_video"])
        done = watch(session.environment)
        assert done.returncode == 0, done.stderr
        lines = re.findall(r"^\w+: \(480, 640, 3\), \d+ ms old$", done.stdout, re.MULTILINE)
        assert lines == done.stdout.splitlines() != []
        code, report = session.interrupt()
        assert (code, report["failures"]) == (0, [])
        session.assert_nothing_left()


def test_without_a_session_it_says_so_in_one_line(tmp_path):
    done = watch({"TMPDIR": str(tmp_path), "PATH": "/usr/bin:/bin"})
    assert done.returncode != 0
    assert done.stderr.startswith("watch_operator: ")
    assert len(done.stderr.splitlines()) == 1
