"""Unit tests start no process and run no session."""

import multiprocessing
import os
import subprocess
import sys

import pytest
from positions import ROOT
from unit_room import closed_doors

from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.virtual.simulate import simulate


@pytest.mark.parametrize(
    "start",
    [
        lambda: subprocess.run([sys.executable, "-c", ""]),
        lambda: multiprocessing.Process(target=print).start(),
        lambda: os.fork(),
        lambda: simulate(BUILT_IN["taskboard"], seconds=0.1, seed=1, media=False),
    ],
    ids=["subprocess", "multiprocessing", "fork", "simulate"],
)
def test_a_unit_test_can_start_neither_a_process_nor_a_session(start):
    with closed_doors(), pytest.raises(AssertionError, match="tests/realtime"):
        start()


def test_every_unit_test_runs_behind_closed_doors(tmp_path):
    """Checked with pytest itself, on a unit test that starts a process."""
    room = tmp_path / "tests" / "unit"
    room.mkdir(parents=True)
    (room / "conftest.py").write_text((ROOT / "tests" / "unit" / "conftest.py").read_text())
    (room / "test_it.py").write_text(
        "import subprocess, sys\ndef test_it():\n    subprocess.run([sys.executable, '-c', ''])\n"
    )
    helpers = f"pythonpath={ROOT / 'tests' / 'helpers'}"
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-o", helpers, str(room)],
        capture_output=True,
        text=True,
        cwd=ROOT,
        timeout=120,
    )
    assert done.returncode == 1
    assert "Popen.__init__ in a unit test: move it to tests/realtime" in done.stdout
