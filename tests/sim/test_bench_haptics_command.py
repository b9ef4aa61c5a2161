"""`python -m benchmarks haptics`: a cell, its figures and its claims."""

import json

import cv2

from benchmarks.__main__ import main
from benchmarks.haptics import claims as haptics_claims

CELL = ["--cell", "delay=100", "--seconds", "4", "--jobs", "1"]


def test_the_command_writes_its_figures(tmp_path, capsys):
    report, picture = tmp_path / "h.json", tmp_path / "h.png"
    assert main(["haptics", *CELL, "--report", str(report), "--plot", str(picture)]) == 0
    found = json.loads(report.read_text())
    assert found["cells"] == 1
    assert all(claim["holds"] for claim in found["claims"])
    assert found["without"][0]["unstable"]
    assert not found["with"][0]["unstable"]
    assert cv2.imread(str(picture)).shape[2] == 3
    assert "UNSTABLE" in capsys.readouterr().out


def test_a_claim_that_does_not_hold_exits_with_1(monkeypatch, capsys):
    monkeypatch.setattr(haptics_claims, "RISE_N_MS", 1e-6)
    assert main(["haptics", *CELL]) == 1
    assert "NO" in capsys.readouterr().out
