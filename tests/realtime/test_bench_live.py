"""The live halves of two benches, short."""

import json

from running_session import free_base_port

from pipelines.cli import main


def test_latency_is_measured_live_beside_virtual_time(tmp_path):
    report = tmp_path / "r.json"
    words = ["bench", "latency", "--seconds", "1", "--live-seconds", "8", "--load", "1"]
    words += ["--base-port", str(free_base_port()), "--report", str(report)]
    assert main(words) == 0
    leads = json.loads(report.read_text())["leads"]
    live = [lead for name, lead in leads.items() if "live" in name]
    assert live and all(lead["video_ms"]["total"] > 0 for lead in live)


def test_light_and_click_are_compared_with_the_stamps_of_a_live_session(tmp_path):
    report = tmp_path / "r.json"
    words = ["bench", "sync", "--live", "--seconds", "12"]
    words += ["--base-port", str(free_base_port()), "--report", str(report)]
    assert main(words) == 0
    assert json.loads(report.read_text())
