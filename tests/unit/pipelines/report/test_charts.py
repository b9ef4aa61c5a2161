"""Charts of the benches: what they show, and what `--plot` refuses."""

from math import nan

import cv2
import pytest

from pipelines.cli import main
from pipelines.report.charts import distributions, save

# On its first import on a machine it starts a program that lists the fonts.
pytest.importorskip("matplotlib.font_manager")


def test_a_distribution_ends_at_100_percent_and_says_its_unit(tmp_path):
    panels = {"one": {"a": [3.0, 1.0, 2.0, nan], "b": []}, "two": {"c": []}, "three": {"d": [1.0]}}
    figure = distributions(panels, axis="delay, ms", columns=2)
    first, second, third, unused = figure.axes
    (line,) = first.lines
    assert list(line.get_xdata()) == [1.0, 2.0, 3.0]
    assert list(line.get_ydata())[-1] == 100
    assert (first.get_title(), first.get_xlabel()) == ("one", "delay, ms")
    assert [text.get_text() for text in second.texts] == ["nothing was measured"]
    assert third.get_legend() is not None
    assert not unused.get_visible()
    save(figure, tmp_path / "chart.png")
    assert cv2.imread(str(tmp_path / "chart.png")).shape[2] == 3


def test_without_matplotlib_plot_names_the_extra(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("pipelines.report.charts.find_spec", lambda name: None)
    plot = str(tmp_path / "lead.png")
    assert main(["bench", "latency", "--no-live", "--seconds", "1", "--plot", plot]) == 2
    error = capsys.readouterr().err
    assert "pip install 'kontur-av[bench]'" in error
    assert error.count("\n") == 1
