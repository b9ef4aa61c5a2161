"""The summary of a session: it fits the terminal, and shows the stages of the picture."""

from dataclasses import replace

import msgspec
import pytest
from rich.console import Console

from pipelines.report.summary import first_line, print_summary, stages_line, streams_table
from pipelines.report.warnings import restart_warning
from pipelines.session.setup.built_in import BUILT_IN
from pipelines.virtual.simulate import simulate


@pytest.fixture(scope="module")
def report():
    return simulate(replace(BUILT_IN["spacejustin"], radio="clean"), seconds=0.6, seed=1)


@pytest.mark.parametrize("width", [60, 80, 100, 120, 200])
def test_no_name_and_no_number_is_cut(report, width):
    console = Console(width=width)
    with console.capture() as capture:
        console.print(streams_table(report, width))
    lines = capture.get().splitlines()
    assert "…" not in capture.get()
    assert max(map(len, lines)) <= width
    for name, stream in report.streams.items():
        (line,) = [line for line in lines if f" {name} " in line]
        assert f" {stream.latency_ms.p50:.1f} " in line


def test_the_first_line_names_setup_link_and_radio(report):
    assert first_line(report, 80).startswith("spacejustin, 0.6 s   link ")
    assert first_line(report, 80).endswith("radio clean")


def test_the_stages_of_the_uplink_picture_add_up(report):
    words = stages_line(report).split()
    total, *terms = [int(word.strip(":,")) for word in words if word[0].isdigit()]
    assert abs(total - sum(terms)) <= 4
    assert stages_line(report).startswith("uplink picture ")


def test_a_warning_is_a_line_with_its_mend(report, capsys):
    assert report.warnings == []
    warning = restart_warning("stereo", 1, "ended by SIGKILL")
    print_summary(msgspec.structs.replace(report, warnings=[warning]))
    printed = " ".join(capsys.readouterr().out.split())
    assert "warning: stereo: it was started again once: ended by SIGKILL; mend what" in printed
