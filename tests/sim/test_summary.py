"""The summary of a session: it fits the terminal, and shows the stages of the picture."""

import json
import re
from collections import Counter
from dataclasses import replace
from html import unescape

import msgspec
import pytest
from rich.console import Console

from pipelines.cli import main
from pipelines.report.model import to_json
from pipelines.report.report_file import end_report
from pipelines.report.summary import first_line, stages_line, streams_table
from pipelines.report.warnings import restart_warning
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.session.task_journal import TaskRow, TaskStep
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


def test_setup_link_and_radio_are_named_and_the_stages_of_the_uplink_picture_add_up(report):
    assert first_line(report, 80).startswith("spacejustin, 0.6 s   link ")
    assert first_line(report, 80).endswith("radio clean")
    words = stages_line(report).split()
    total, *terms = [int(word.strip(":,")) for word in words if word[0].isdigit()]
    assert abs(total - sum(terms)) <= 4
    assert stages_line(report).startswith("uplink picture ")


def test_a_warning_is_a_line_with_its_mend(report, capsys):
    assert report.warnings == []
    warning = restart_warning("stereo", 1, "ended by SIGKILL")
    told = msgspec.structs.replace(report, warnings=[warning], failures=["clip[red].mp4 is mute"])
    assert end_report(told, None, quiet=False) == 1
    printed = " ".join(capsys.readouterr().out.split())
    assert "failed: clip[red].mp4 is mute" in printed
    assert "warning: stereo: it was started again once: ended by SIGKILL; fix what" in printed
    assert end_report(told, None, quiet=True) == 1
    quiet = capsys.readouterr()
    assert quiet.out == "" and quiet.err == "failed: clip[red].mp4 is mute\n"
    assert end_report(report, None, quiet=True) == 0


RUN = TaskRow(
    name="aiming",
    run=3,
    result="timed_out",
    reason="it took <too> long",
    selected_ns=200_000_000,
    seconds=0.2,
    path_m=0.02,
    force_max_n=3.5,
    force_mean_n=1.0,
    error_mean=None,
    error_max=None,
    frames=600,
    frames_lost=0,
    delay_ms=3.0,
    steps=[TaskStep(at_ns=500_000_000, step="the cosmonaut starts")],
)


def test_an_account_tells_what_happened_and_what_fell_short(report, tmp_path, capsys):
    told = msgspec.structs.replace(
        report,
        failures=["<b>uplink_video</b> broke its cap"],
        warnings=[restart_warning("stereo", 1, "ended by SIGKILL")],
        tasks=[RUN],
        stopped_s=[(0.5, 99.0)],
    )
    path = tmp_path / "r.json"
    path.write_text(to_json(told))
    assert main(["report", str(path), "--html"]) == 0
    assert capsys.readouterr().out.strip() == str(tmp_path / "r.html")
    page = (tmp_path / "r.html").read_text()
    assert "<b>uplink_video</b> broke" not in page
    for words in (
        "failed: <b>uplink_video</b> broke its cap",
        "aiming, run 3: the cosmonaut starts",
        "task aiming, run 3: timed out after 0.2 s: it took <too> long",
        "force 1.0 N, at most 3.5 N",
        f">p50 {report.streams['uplink_video'].latency_ms.p50:.1f}, ",
    ):
        assert words in unescape(page)
    places = re.findall(r"([\d.e+-]+|nan|inf)%", page)
    assert places and all(0 <= float(place) <= 100 for place in places)
    opened, closed = (re.findall(rf"<{end}([a-z]\w*)", page) for end in ("", "/"))
    assert Counter(closed) == Counter(tag for tag in opened if tag != "meta")


def test_a_report_is_shown_again_and_a_file_that_is_none_is_refused(report, tmp_path, capsys):
    path = tmp_path / "r.json"
    path.write_text(to_json(report))
    assert main(["report", str(path)]) == 0
    assert "spacejustin, 0.6 s" in capsys.readouterr().out
    path.write_text("[]")
    assert main(["report", str(path), "--html"]) == 2
    assert "no report of a session" in capsys.readouterr().err
    assert not (tmp_path / "r.html").exists()


@pytest.mark.parametrize("with_error", [False, True])
def test_a_report_is_as_its_schema_says(report, capsys, with_error):
    schema = pytest.importorskip("jsonschema", reason="pip install -e '.[dev]'")
    assert main(["report", "--schema"]) == 0
    validator = schema.Draft202012Validator(json.loads(capsys.readouterr().out))
    found = json.loads(to_json(report)) | ({"secnds": 1} if with_error else {})
    assert validator.is_valid(found) is not with_error
