"""Campaigns on a cluster of Dask: a scheduler and two workers, one of which is killed."""

import json
import os
import signal
import socket
import sys
import threading
from contextlib import ExitStack
from pathlib import Path

import pytest
from common import eventually
from programs import running

from benchmarks.__main__ import main as benchmark
from pipelines.cli import main
from pipelines.virtual.campaign import sessions
from pipelines.virtual.campaign.sessions import Cluster

pytest.importorskip("distributed", reason="needs Dask: the extra cluster")

SWEEP = """
seconds = 3
seeds = 1
media = false
[[grid]]
radio = ["iss-overhead", "geo"]
"""


class Processes(ExitStack):
    """A scheduler and its workers, each a process of its own."""

    def __init__(self, folder):
        super().__init__()
        self.folder = folder
        self.started = 0
        found = folder / "scheduler.json"
        self._start("scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", found)
        eventually(lambda: found.exists() and found.read_text().rstrip().endswith("}"))
        self.address = json.loads(found.read_text())["address"]

    def worker(self, *options):
        folder = self.folder / f"worker{self.started}"
        words = [self.address, "--host", "127.0.0.1", "--nthreads", "1", "--no-dashboard"]
        started = self._start("worker", *words, "--local-directory", folder, *options)
        eventually(lambda: b"Registered to" in self.log.read_bytes())
        return started

    def _start(self, what, *words):
        self.log = self.folder / f"{what}{self.started}.log"
        self.started += 1
        command = (sys.executable, "-m", "dask", what, *words)
        return self.enter_context(running(self.log, *command, patience_s=20))


@pytest.fixture(scope="module")
def processes(tmp_path_factory):
    with Processes(tmp_path_factory.mktemp("dask")) as started:
        started.worker()  # With its nanny, a daemon, which multiprocessing would forbid children.
        yield started


def sessions_of(pid):
    """The numbers of the processes in which the worker `pid` runs sessions."""
    listed = [task / "children" for task in Path(f"/proc/{pid}/task").iterdir()]
    children = [child for children in listed for child in children.read_text().split()]
    return [
        int(child)
        for child in children
        if b"pipelines.virtual.campaign.sessions" in Path(f"/proc/{child}/cmdline").read_bytes()
    ]


def test_a_sweep_is_the_same_octet_by_octet_though_a_worker_is_killed(tmp_path, capfd):
    (tmp_path / "mine.toml").write_text(SWEEP)
    alone, there = tmp_path / "here.json", tmp_path / "there.json"
    command = ["sweep", str(tmp_path / "mine.toml"), "--report"]
    assert main([*command, str(alone)]) == 0
    orphans = []
    with Processes(tmp_path) as processes:
        # Alone, so that it surely has a run. Another one does what it leaves.
        doomed = processes.worker("--no-nanny")

        def kill():
            orphans.extend(eventually(lambda: sessions_of(doomed.pid)))
            os.kill(doomed.pid, signal.SIGKILL)
            processes.worker()

        killer = threading.Thread(target=kill)
        killer.start()
        assert main([*command, str(there), "--cluster", processes.address]) == 0
        killer.join()
    assert doomed.wait() == -signal.SIGKILL
    assert there.read_bytes() == alone.read_bytes()
    assert "2 of 2 runs" in capfd.readouterr().err
    # No session outlives the worker that started it.
    eventually(lambda: not any(Path(f"/proc/{pid}").exists() for pid in orphans))


def test_cells_of_the_hand_are_the_same_octet_by_octet(processes, tmp_path, capfd):
    alone, there = tmp_path / "here.json", tmp_path / "there.json"
    command = ["haptics", "--cell", "delay=20", "--cell", "loss=30,burst=10"]
    assert benchmark([*command, "--report", str(alone)]) == 0
    assert benchmark([*command, "--report", str(there), "--cluster", processes.address]) == 0
    assert there.read_bytes() == alone.read_bytes()


def refused(address, capfd, tmp_path):
    """The one line with which a sweep on this cluster is refused."""
    (tmp_path / "mine.toml").write_text(SWEEP)
    capfd.readouterr()
    assert main(["sweep", str(tmp_path / "mine.toml"), "--cluster", address]) == 2
    *progress, error = capfd.readouterr().err.splitlines()
    assert all(line.endswith(" runs") for line in progress)
    return error


def test_workers_and_schedulers_of_another_version_are_refused(
    processes, tmp_path, capfd, monkeypatch
):
    monkeypatch.setattr(sessions, "code_digest", lambda: "newer")
    told = ", and this machine newer: install the same"
    assert told in refused(processes.address, capfd, tmp_path)
    # One that comes after the first look refuses its first run.
    monkeypatch.setattr(Cluster, "_check_workers", lambda _: None)
    assert told in refused(processes.address, capfd, tmp_path)
    monkeypatch.setattr(sessions, "version", lambda name: "1.0")
    error = refused(processes.address, capfd, tmp_path)
    assert "the scheduler has distributed " in error
    assert "and this machine 1.0: install the same" in error


def test_what_is_no_scheduler_is_refused(tmp_path, capfd, monkeypatch):
    monkeypatch.setattr(sessions, "_CONNECT_S", 1)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        address = f"tcp://127.0.0.1:{silent.getsockname()[1]}"
        assert "no scheduler of Dask" in refused(address, capfd, tmp_path)
    assert "no scheduler of Dask" in refused(address, capfd, tmp_path)
    assert "write tcp://HOST:PORT" in refused("127.0.0.1:8786", capfd, tmp_path)
