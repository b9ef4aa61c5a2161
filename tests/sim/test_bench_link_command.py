"""`kontur-av bench link`: its tables and its figures."""

import json

from pipelines.cli import main


def test_the_command_prints_tables_and_writes_metrics(tmp_path, capsys):
    report = tmp_path / "figures.json"
    command = ["bench", "link", "--no-live", "--seconds", "1"]
    assert main([*command, "--report", str(report)]) == 0
    printed = capsys.readouterr().out
    assert "uplink, saturated" in printed
    metrics = json.loads(report.read_text())
    assert set(metrics) == {"cost", "headlines"}
