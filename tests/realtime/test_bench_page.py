"""`python -m benchmarks page`: the whole way once, in a real Chromium on a virtual screen."""

import json
import shutil

import numpy as np
import pytest

from benchmarks.__main__ import main
from benchmarks.page import command as page
from benchmarks.page.footage import HEIGHT, WIDTH, pictures
from benchmarks.page.page_metrics import OURS, PEER
from benchmarks.page.screen import Spot, number_at

HERE = all(shutil.which(name) for name in ("chromium", "chromedriver", "Xvfb"))


def test_a_number_is_read_where_the_picture_is_on_the_screen():
    picture = list(pictures(8))[-1]
    screen = np.full((HEIGHT + 50, WIDTH + 30, 4), 128, np.uint8)
    screen[50:, 30:] = picture[:HEIGHT, :, None]
    assert number_at(screen, Spot(left=30, top=50, scale=1.0).points()) == 7
    assert number_at(screen, Spot(left=0, top=0, scale=1.0).points()) is None


def test_a_machine_without_a_browser_measures_nothing_and_says_so(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(page, "lacking", lambda: "chromium is missing: apt-get install chromium")
    report = tmp_path / "page.json"
    assert main(["page", "--report", str(report)]) == 0
    assert "not measured: chromium is missing" in capsys.readouterr().out
    assert json.loads(report.read_text())["headlines"] == []
    assert main(["page", "--seconds", "900"]) == 2
    assert "--seconds" in capsys.readouterr().err


@pytest.mark.skipif(not HERE, reason="chromium: apt-get install chromium chromium-driver xvfb")
def test_the_page_and_its_peer_show_numbered_pictures(tmp_path):
    from benchmarks.page.footage import FPS, coded
    from benchmarks.page.views import measured

    units = coded(40 * FPS)
    for who in (OURS, PEER):
        run, delays_ms = measured(who, 1, units, 3.0)
        assert run.seen > 0, who
        assert min(delays_ms) > 0
