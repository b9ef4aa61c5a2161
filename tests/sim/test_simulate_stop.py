"""A simulation that is stopped reports what it has simulated."""

import json
import signal

from kontur_av.clock import NS_PER_S
from pipelines.cli import main
from pipelines.session.setup.setup_file import load_setup
from pipelines.virtual import simulate as simulate_module
from pipelines.virtual.session import Simulation
from pipelines.virtual.workers import Workers


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


def test_ctrl_c_ends_the_command_with_its_report(tmp_path, monkeypatch, capfd):
    class InterruptedSimulation(Simulation):
        """Ctrl-C comes when a second of virtual time has passed."""

        def run(self, until_ns):
            super().run(until_ns)
            if until_ns == NS_PER_S:
                signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(simulate_module, "Simulation", InterruptedSimulation)
    path = tmp_path / "report.json"
    command = ["simulate", "--setup", "spacejustin", "--seconds", "100000", "--no-media"]
    assert main([*command, "--report", str(path)]) == 0
    assert not capfd.readouterr().err
    assert json.loads(path.read_text())["seconds"] == 1.0
