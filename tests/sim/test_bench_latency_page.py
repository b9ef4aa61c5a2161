"""`kontur-av bench latency`: the page of a simulated session."""

import json

import cv2
import pytest

from pipelines.bench import latency
from pipelines.cli import main
from pipelines.report.terms import TERMS


def test_the_page_is_printed_written_and_drawn(tmp_path, capsys):
    plot, written = tmp_path / "lead.png", tmp_path / "figures.json"
    command = ["bench", "latency", "--setup", "taskboard", "--no-live", "--seconds", "2"]
    assert main([*command, "--plot", str(plot), "--report", str(written)]) == 0
    printed = capsys.readouterr().out
    for words in ("taskboard", "radio clean", "capture to encoded", "serialisation", "not meant"):
        assert words in printed
    figures = json.loads(written.read_text())
    assert set(figures["leads"]) == {"taskboard, virtual", "spacejustin, virtual"}
    for lead in figures["leads"].values():
        video = lead["video_ms"]
        assert sum(video[term] for term in TERMS) == pytest.approx(video["total"], abs=0.005)
        # On virtual time these are the configured costs.
        assert (video["capture"], video["encoding"]) == (4.0, 6.0)
        assert video["propagation"] == 10.0
        assert lead["force_ms"]["total"] == 11.0
    latency = figures["virtual"]["streams"]["uplink_video"]["latency_ms"]
    assert latency["p99"] <= latency["p99.9"] <= latency["max"]
    assert figures["clocks"]["virtual"]["error_us"] == 0
    assert cv2.imread(str(plot)).min() < 50


def test_a_missed_target_is_shown_and_is_no_failure(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(latency, "VIDEO_MS", 1.0)
    written = tmp_path / "figures.json"
    command = ["bench", "latency", "--no-live", "--seconds", "2", "--report", str(written)]
    assert main(command) == 0
    assert "MISSED" in capsys.readouterr().out
    found = {(one["what"], one["who"]): one for one in json.loads(written.read_text())["headlines"]}
    missed = found["uplink_video, capture to display, p99", "virtual time"]
    assert (missed["target"], missed["met"]) == ("<= 1 ms", False)
