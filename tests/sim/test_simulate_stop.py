"""A simulation that is stopped reports what it has simulated."""

import json
import signal
import subprocess
import sys
import time
from itertools import count

from kontur_av.clock import NS_PER_S
from pipelines.commands.simulate import simulate
from pipelines.session.setup.setup_file import load_setup
from pipelines.virtual.session import Simulation
from pipelines.virtual.workers import Workers


def test_a_simulation_that_is_stopped_reports_the_time_until_then():
    looks = count()
    report = simulate(
        load_setup("spacejustin"),
        seconds=3600,
        seed=1,
        media=False,
        stopped=lambda: next(looks) >= 30,
    )
    assert report.seconds == 1.5
    assert report.haptic["up"].receiver.received > 1000


def test_a_run_in_pieces_gives_the_same_report():
    setup = load_setup("spacejustin")
    reports = []
    for stride_ns in (2 * NS_PER_S, 7_300_000):
        with Workers() as workers:
            simulation = Simulation(setup, workers, seed=1, media=False)
            for until_ns in range(stride_ns, 2 * NS_PER_S, stride_ns):
                simulation.run(until_ns)
            simulation.run(2 * NS_PER_S)
            reports.append(simulation.report())
    assert reports[0] == reports[1]


def test_ctrl_c_ends_the_command_with_its_report(tmp_path):
    path = tmp_path / "report.json"
    command = [sys.executable, "-m", "pipelines.cli", "simulate", "--setup", "spacejustin"]
    command += ["--seconds", "100000", "--no-media", "--report", str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        time.sleep(4)
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=60)
    assert process.returncode == 0, errors
    assert not errors
    assert 0 < json.loads(path.read_text())["seconds"] < 100_000
