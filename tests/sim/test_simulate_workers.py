"""A simulation forks its coders from a process that may have used any library before."""

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from functools import partial

import pytest

from pipelines.virtual.workers import Workers

USED_BEFORE = """
import cv2, numpy
cv2.setNumThreads(4)
noise = numpy.random.default_rng(1).integers(0, 2, (960, 1280), numpy.uint8)
for _ in range(20):
    cv2.connectedComponentsWithStats(noise)
    cv2.resize(noise, (640, 480), interpolation=cv2.INTER_AREA)
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.virtual.simulate import simulate
print(simulate(BUILT_IN["taskboard"], seconds=0.5, seed=1).seconds)
"""


def test_earlier_opencv_threads_do_not_block_workers():
    ended = subprocess.run(
        [sys.executable, "-c", USED_BEFORE], capture_output=True, text=True, timeout=60, check=False
    )
    assert (ended.returncode, ended.stdout.strip()) == (0, "0.5"), ended.stderr


def test_a_worker_that_dies_is_an_error_and_none_is_left():
    with Workers() as workers, pytest.raises(RuntimeError, match="its process has ended"):
        workers.start(lambda: abs)
        killed = workers.start(lambda: partial(os.kill, os.getpid()))
        killed.submit(signal.SIGKILL)
        while len(multiprocessing.active_children()) == 2:
            time.sleep(0.01)
        killed.submit(0).result()
    assert not multiprocessing.active_children()
