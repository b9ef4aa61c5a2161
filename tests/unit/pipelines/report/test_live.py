"""What a running session shows, on a terminal and elsewhere."""

from types import SimpleNamespace

import pytest
from rich.console import Console
from told import message

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.streams.staleness import State
from pipelines.media.media_metrics import CaptureMetrics, DisplayMetrics
from pipelines.report.collector import Collector
from pipelines.report.live import _age, _inputs, _line, first_line, streams_table
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
        seconds=10.0,
        clock=SimpleNamespace(now_ns=lambda: 10 * NS_PER_S),
    )


def table_of(launcher):
    console = Console(width=118)
    with console.capture() as capture:
        console.print(streams_table(launcher, launcher.collector, 118))
    return capture.get()


def test_the_shown_rate_is_that_of_the_last_second(launcher):
    # 80 kbit/s in seconds 0 and 1, then 40 kbit/s; reported up to half a second ago.
    rows = [OutRow(k * 10 * NS_PER_MS, 100 if k < 200 else 50, 90_000) for k in range(951)]
    launcher.collector.handle_message("uplink_video_send", message(rows=rows), 9 * NS_PER_S)
    felt = [SampleReceivedRow(k % 65536, k * NS_PER_MS) for k in range(8501, 9501)]
    launcher.collector.handle_message("joystick", message(rows=felt), 9 * NS_PER_S)
    assert "uplink_video 40.0/90 kbit/s" in _line(launcher, launcher.collector)
    table = table_of(launcher)
    (video,) = [line for line in table.splitlines() if "uplink_video" in line]
    assert " 40.0 " in video
    assert " 80.0 " in video, "the largest second"
    (force,) = [line for line in table.splitlines() if "haptic_up" in line]
    assert " 96.0 " in force
    launcher.clock.now_ns = lambda: 20 * NS_PER_S
    assert "uplink_video 0.0/90 kbit/s" in _line(launcher, launcher.collector)


def test_each_stream_is_shown_with_its_age_and_state(launcher):
    (stream,) = SETUP.streams

    def shown(state, age_ms, told_s):
        gauges = DisplayMetrics(age_ns=age_ms * NS_PER_MS, state=State(state))
        launcher.collector.handle_message(
            "space_display", message(gauges, stream=stream.name), round(told_s * NS_PER_S)
        )
        return _age(launcher, launcher.collector, stream)

    assert _age(launcher, launcher.collector, stream).plain == "–"
    assert "age" in table_of(launcher)
    fresh = shown("fresh", 45, 9.8)
    assert (fresh.plain, str(fresh.style)) == ("45 ms fresh", "green")
    assert "STALE" not in _line(launcher, launcher.collector)
    assert shown("damaged", 45, 9.8).plain == "45 ms damaged"
    assert shown("frozen", 100, 9.8).plain == "100 ms frozen"
    stale = shown("stale", 1300, 9.8)
    assert (stale.plain, str(stale.style)) == ("1.3 s stale", "bold white on red")
    assert "STALE 1.3 s" in _line(launcher, launcher.collector)
    # A display that reports nothing any more still shows its last picture.
    assert shown("fresh", 45, 6.0).plain == "3.0 s stale"


def test_an_input_without_pictures_is_shown_with_its_fault(launcher):
    for name, captured_s, fault in (
        ("left", 7, "the writer has gone"),
        ("right", 9, "garbage in the pipe"),
        ("static", 9, ""),
    ):
        gauges = CaptureMetrics(captured_ns=captured_s * NS_PER_S, source_fault=fault)
        launcher.collector.handle_message(f"camera_{name}", message(gauges), 9 * NS_PER_S)
    silent = "camera_left: no picture for 3 s (the writer has gone)"
    lines = [(line.plain, str(line.style)) for line in _inputs(launcher, launcher.collector)]
    assert lines == [(silent, "bold red"), ("camera_right: garbage in the pipe", "yellow")]
    assert _line(launcher, launcher.collector).endswith(silent)


@pytest.mark.parametrize("width", [40, 60, 80, 100, 120, 200])
def test_no_name_and_no_number_is_cut_at_any_width(launcher, width):
    launcher.setup = BUILT_IN["spacejustin"]
    launcher.collector = Collector(topology_of(launcher.setup))
    shown = message(DisplayMetrics(frames_displayed=1234567890), stream="uplink_video")
    launcher.collector.handle_message("space_display", shown, 9 * NS_PER_S)
    console = Console(width=width)
    with console.capture() as capture:
        console.print(streams_table(launcher, launcher.collector, width))
    lines = capture.get().splitlines()
    assert "…" not in capture.get()
    assert max(map(len, lines)) <= width
    names = [stream.name for stream in launcher.setup.streams]
    assert all(any(f" {name} " in line for line in lines) for name in names)
    assert width < 80 or "1234567890" in capture.get()
    assert width < 120 or all(heading in lines[1] for heading in ("p99 ms", "max 1 s", "age"))


def test_a_stop_on_request_is_shown_as_one_and_not_as_silence(launcher):
    old = DisplayMetrics(age_ns=NS_PER_S, state=State.STALE)
    for process, told, stream in (
        ("camera_left", CaptureMetrics(captured_ns=0), ""),
        ("space_display", old, "uplink_video"),
    ):
        launcher.collector.handle_message(process, message(told, stream=stream), NS_PER_S)
    assert "STALE" in _line(launcher, launcher.collector)
    launcher.switch.handle_order(Order.STOP, 2 * NS_PER_S)
    assert _inputs(launcher, launcher.collector) == []
    line = _line(launcher, launcher.collector)
    assert line.endswith("stopped from a page") and "STALE" not in line
    first = first_line(launcher, launcher.collector, 118)
    assert first.startswith("taskboard-7   10 s   ") and "stopped from a page" in first
