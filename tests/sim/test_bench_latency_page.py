"""`kontur-av bench latency`: the page of a simulated session."""

import json

import cv2
import pytest

from pipelines.cli import main
from pipelines.report.terms import TERMS


def test_the_page_is_printed_written_and_drawn(tmp_path, capsys):
    plot, written = tmp_path / "lead.png", tmp_path / "figures.json"
    command = ["bench", "latency", "--setup", "taskboard", "--no-live", "--seconds", "2"]
    assert main([*command, "--plot", str(plot), "--report", str(written)]) == 0
    printed = capsys.readouterr().out
    for words in ("taskboard", "radio clean", "capture to encoded", "serialisation", "not meant"):
        assert words in printed
    metrics = json.loads(written.read_text())
    assert set(metrics["leads"]) == {"taskboard, virtual", "spacejustin, virtual"}
    for lead in metrics["leads"].values():
        video = lead["video_ms"]
        assert sum(video[term] for term in TERMS) == pytest.approx(video["total"], abs=0.005)
        # On virtual time these are the configured costs.
        assert (video["capture"], video["encoding"]) == (4.0, 6.0)
        assert video["propagation"] == 10.0
        assert lead["force_ms"]["total"] == 11.0
    latency = metrics["virtual"]["streams"]["uplink_video"]["latency_ms"]
    assert latency["p99"] <= latency["p99.9"] <= latency["max"]
    assert metrics["clocks"]["virtual"]["error_us"] == 0
    assert cv2.imread(str(plot)).min() < 50
