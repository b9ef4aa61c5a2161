"""`kontur-av bench cpu`: figures, pairs of runs, and the refused options of every bench."""

import json

import pytest
from positions import ROOT

from pipelines.bench import cpu
from pipelines.bench.cpu import CpuResult, CpuRun, headlines, read_run
from pipelines.cli import main


def report(cpu_s, count=9):
    latency = {"p50": 40.0, "p99": 60.0, "count": count}
    streams = {"uplink_video": {"latency_ms": latency}}
    return json.dumps({"seconds": 10.0, "cpu": {"total_s": cpu_s}, "streams": streams})


def test_a_run_is_read_from_its_report_and_ratios_are_computed_for_each_pair():
    assert read_run(report(12.0)) == CpuRun(cpu_s_per_s=1.2, video_p50_ms=40.0, video_p99_ms=60.0)
    assert read_run(report(12.0, count=0)).video_p99_ms is None
    with pytest.raises(KeyError, match="streams"):
        read_run(b'{"seconds": 1.0}')

    def runs(*values):
        return tuple(read_run(report(10 * value)) for value in values)

    result = CpuResult("spacejustin", 10.0, runs(1.0, 0.8, 0.9), runs(1.25, 1.0, 1.0))
    assert result.ratios == pytest.approx([0.8, 0.8, 0.9])
    found = {(headline.what, headline.who): headline.value for headline in headlines(result)}
    assert found["CPU time, this tree over the other", "pairs"] == pytest.approx(0.8)
    assert found["CPU of a session second, all processes", "other tree"] == pytest.approx(1.0)
    alone = headlines(CpuResult("spacejustin", 10.0, runs(1.0)))
    assert [one.who for one in alone] == [""] * 3


def test_two_trees_take_turns(tmp_path, monkeypatch, capsys):
    other = tmp_path / "other"
    (other / "pipelines").mkdir(parents=True)
    (other / "pipelines" / "cli.py").touch()
    asked = []

    def live_report(words, *, seconds, tree=None):
        asked.append(tree)
        return report(10.0 if tree == other else 8.0)

    monkeypatch.setattr(cpu, "live_report", live_report)
    written = tmp_path / "cpu.json"
    words = ["bench", "cpu", "--against", str(other), "--runs", "2", "--report", str(written)]
    assert main(words) == 0
    assert asked == [ROOT, other, ROOT, other]
    assert "0.800 (0.800 to 0.800)" in capsys.readouterr().out
    metrics = json.loads(written.read_text())
    assert [one["cpu_s_per_s"] for one in metrics["against"]] == [1.0, 1.0]
