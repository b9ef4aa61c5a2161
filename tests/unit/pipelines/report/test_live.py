"""What a running session shows, on a terminal and elsewhere."""

from types import SimpleNamespace

import pytest
from rich.console import Console
from told import message, processes

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.streams.staleness import State
from pipelines.media.media_metrics import CaptureMetrics, DisplayMetrics
from pipelines.report.collector import Collector
from pipelines.report.live import _inputs, first_line, session_line
from pipelines.report.session_report import build_report
from pipelines.report.summary import LIVE_COLUMNS, streams_table
from pipelines.session.session_metrics import OutRow, SampleReceivedRow
from pipelines.session.session_switch import Order, SessionSwitch
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.table import topology_of

SETUP = BUILT_IN["taskboard"]


@pytest.fixture
def launcher():
    """The parts of a session of ten seconds that a view reads."""
    return SimpleNamespace(
        setup=SETUP,
        session="taskboard-7",
        collector=Collector(topology_of(SETUP)),
        children=[],
        switch=SessionSwitch(),
        now_ns=10 * NS_PER_S,
    )


def report_of(launcher):
    now_ns, names = launcher.now_ns, [row.name for row in launcher.collector.topology.processes]
    return build_report(launcher.collector, seconds=10.0, processes=processes(names), now_ns=now_ns)


def table_of(launcher, width=118):
    console = Console(width=width)
    with console.capture() as capture:
        console.print(streams_table(report_of(launcher), width, LIVE_COLUMNS))
    return capture.get()


def line_of(launcher):
    return session_line(launcher, report_of(launcher))


def test_the_shown_rate_is_that_of_the_last_second(launcher):
    # 80 kbit/s in seconds 0 and 1, then 40 kbit/s; reported up to half a second ago.
    rows = [OutRow(k * 10 * NS_PER_MS, 100 if k < 200 else 50, 90_000) for k in range(951)]
    launcher.collector.handle_message("uplink_video_send", message(rows=rows), 9 * NS_PER_S)
    felt = [SampleReceivedRow(k % 65536, k * NS_PER_MS) for k in range(8501, 9501)]
    launcher.collector.handle_message("joystick", message(rows=felt), 9 * NS_PER_S)
    assert "uplink_video 40.0/90 kbit/s" in line_of(launcher)
    table = table_of(launcher)
    (video,) = [line for line in table.splitlines() if "uplink_video" in line]
    assert " 40.0 " in video
    assert " 80.0 " in video, "the largest second"
    (force,) = [line for line in table.splitlines() if "haptic_up" in line]
    assert " 96.0 " in force
    launcher.now_ns = 20 * NS_PER_S
    assert "uplink_video 0.0/90 kbit/s" in line_of(launcher)


def test_each_stream_is_shown_with_its_age_and_state(launcher):
    (stream,) = SETUP.streams

    def shown(state, age_ms, told_s):
        gauges = DisplayMetrics(age_ns=age_ms * NS_PER_MS, state=State(state))
        launcher.collector.handle_message(
            "space_display", message(gauges, stream=stream.name), round(told_s * NS_PER_S)
        )
        return table_of(launcher)

    assert "fresh" not in table_of(launcher)
    assert "age" in table_of(launcher)
    assert "45 ms fresh" in shown("fresh", 45, 9.8)
    assert "STALE" not in line_of(launcher)
    assert "45 ms damaged" in shown("damaged", 45, 9.8)
    assert "100 ms frozen" in shown("frozen", 100, 9.8)
    assert "1.3 s stale" in shown("stale", 1300, 9.8)
    assert "STALE 1.3 s" in line_of(launcher)
    # A display that reports nothing any more still shows its last picture.
    assert "3.0 s stale" in shown("fresh", 45, 6.0)


def test_an_input_without_pictures_is_shown_with_its_fault(launcher):
    for name, captured_s, fault in (
        ("left", 7, "the writer has gone"),
        ("right", 9, "garbage in the pipe"),
        ("static", 9, ""),
    ):
        gauges = CaptureMetrics(captured_ns=captured_s * NS_PER_S, source_fault=fault)
        launcher.collector.handle_message(f"camera_{name}", message(gauges), 9 * NS_PER_S)
    silent = "camera_left: gave nothing in the last 3 s (the writer has gone)"
    lines = [(line.plain, str(line.style)) for line in _inputs(report_of(launcher))]
    assert lines == [(silent, "bold red"), ("camera_right: garbage in the pipe", "yellow")]
    assert line_of(launcher).endswith(silent)


@pytest.mark.parametrize("width", [40, 60, 80, 100, 120, 200])
def test_no_name_and_no_number_is_cut_at_any_width(launcher, width):
    launcher.setup = BUILT_IN["spacejustin"]
    launcher.collector = Collector(topology_of(launcher.setup))
    shown = message(DisplayMetrics(frames_displayed=1234567890), stream="uplink_video")
    launcher.collector.handle_message("space_display", shown, 9 * NS_PER_S)
    table = table_of(launcher, width)
    lines = table.splitlines()
    assert "…" not in table
    assert max(map(len, lines)) <= width
    names = [stream.name for stream in launcher.setup.streams]
    assert all(any(f" {name} " in line for line in lines) for name in names)
    assert width < 80 or "1234567890" in table
    assert width < 120 or all(heading in lines[1] for heading in ("p99", "max 1 s", "age"))


def test_a_stop_on_request_is_shown_as_one_and_not_as_silence(launcher):
    old = DisplayMetrics(age_ns=NS_PER_S, state=State.STALE)
    for process, told, stream in (
        ("camera_left", CaptureMetrics(captured_ns=0), ""),
        ("space_display", old, "uplink_video"),
    ):
        launcher.collector.handle_message(process, message(told, stream=stream), NS_PER_S)
    assert "STALE" in line_of(launcher)
    launcher.switch.handle_order(Order.STOP, 2 * NS_PER_S)
    line = line_of(launcher)
    assert line.endswith("stopped from a page") and "STALE" not in line
    first = first_line(launcher, report_of(launcher), 118)
    assert first.startswith("taskboard-7   10 s   ") and "stopped from a page" in first
