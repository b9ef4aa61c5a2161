"""The launcher forks, so nothing that it loads may start a thread before."""

import subprocess
import sys

PROGRAM = """
import pathlib
from pipelines.cli import main
main(["stream", "--setup", "there-is-none"])  # loads all that a session loads before it forks
from pipelines.session.launcher import load_libraries
load_libraries()
print(len(list(pathlib.Path("/proc/self/task").iterdir())))
"""


def test_the_launcher_has_one_thread_when_it_forks():
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], capture_output=True, text=True, timeout=60, check=True
    )
    assert done.stdout.split() == ["1"], done.stderr
