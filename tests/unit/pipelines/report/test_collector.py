"""The collector joins and compares the reports of processes, and adds them over restarts."""

from dataclasses import replace
from itertools import starmap

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from told import gateway, message

from kontur_av.clock import NS_PER_MS, NS_PER_S
from pipelines.link.link_metrics import SocketMetrics
from pipelines.media.media_metrics import CaptureMetrics, SelectorMetrics
from pipelines.report.collector import Collector, ProcessMetrics
from pipelines.report.journeys import Skew
from pipelines.session import session_metrics as sm
from pipelines.session.probe import Message
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.table import topology_of
from telepresence.haptics.haptic_metrics import SamplesReceived
from telepresence.link.link_metrics import SenderMetrics

SESSION = topology_of(BUILT_IN["spacejustin"])
START_NS = 1_000 * NS_PER_S


@pytest.fixture
def collector():
    return Collector(SESSION)


def publish(collector, process, now_ns, *rows, stream="", metrics=()):
    told = message(*metrics, rows=rows, stream=stream)
    collector.handle_message(process, Message.unpack(told.pack()), now_ns)


def ms(*values):
    return [START_NS + value * NS_PER_MS for value in values]


def feel(collector, at_ms, latency_ms):
    """A force that was measured `latency_ms` before it was displayed to the hand."""
    (received,) = ms(at_ms)
    publish(
        collector, "robot", received, sm.SampleSentRow(at_ms, received - latency_ms * NS_PER_MS)
    )
    publish(collector, "joystick", received, sm.SampleReceivedRow(at_ms, received))


def show(collector, stream, at_ms, latency_ms):
    (displayed,) = ms(at_ms)
    row = sm.ShownRow(at_ms, displayed - latency_ms * NS_PER_MS, displayed)
    publish(collector, "space_display", displayed, row, stream=stream)


def test_a_picture_with_a_missing_stage_has_a_latency_and_a_restarted_sender_one_rate(collector):
    show(collector, "uplink_video", 20, 20)
    publish(collector, "uplink_video_receive", START_NS, sm.RxRow(2, START_NS))
    metrics = collector.streams["uplink_video"]
    assert metrics.latency.count == 1
    assert all(stage.count == 0 for stage in metrics.stages.values())
    captured, displayed = ms(0, 20)
    publish(collector, "uplink_video_send", displayed, sm.TxRow(9, captured, captured, captured))
    row = sm.ShownRow(9, captured + 40_000, displayed)
    publish(collector, "space_display", displayed, row, stream="uplink_video")
    assert collector.streams["uplink_video"].stamp_error.max == 40_000
    first, second, overtaken = ms(0, 500, 400)
    rows = [sm.OutRow(at, 1000, 90_000) for at in (first, second, overtaken)]
    publish(collector, "uplink_video_send", second, *rows[:2])
    collector.process("uplink_video_send").handle_end()
    publish(collector, "uplink_video_send", second, rows[2])
    assert collector.streams["uplink_video"].rate.max_bps() == 24_000


def test_the_skew_of_a_late_sense_is_positive_and_a_silent_sense_has_none(collector):
    feel(collector, 100, 2)
    show(collector, "uplink_voice", 110, 30)
    show(collector, "uplink_video", 120, 52)
    collector.handle_end()
    skews = {name: skew.summary_ms().p50 for name, skew in collector.skews.items()}
    assert skews["video_haptic"] == pytest.approx(50, rel=0.01)
    assert skews["audio_haptic"] == pytest.approx(28, rel=0.01)
    # The voice came before the picture of the same instant.
    assert skews["audio_video"] == pytest.approx(-22, rel=0.01)
    silent = Collector(SESSION)
    feel(silent, 100, 2)
    show(silent, "uplink_video", 1200, 52)
    silent.handle_end()
    assert all(skew.count == 0 for skew in silent.skews.values())


@given(st.lists(st.integers(-(10**9), 10**9), min_size=1, max_size=60))
def test_percentiles_of_a_signed_skew_equal_those_of_its_values(values):
    skew = Skew()
    for value in values:
        skew.add(value)
    summary = skew.summary_ms()
    ordered = np.sort(values)
    assert summary.count == len(values)
    for p in (50, 95, 99):
        rank = len(values) * p / 100
        around = ordered[[max(int(rank) - 2, 0), min(int(rank) + 1, len(values) - 1)]] / 1e6
        slack = 0.005 * np.abs(around).max() + 1e-9
        assert around[0] - slack <= getattr(summary, f"p{p}") <= around[1] + slack
    assert abs(summary.max) == max(abs(value) for value in values) / 1e6


def test_the_counts_of_a_restarted_process_are_added(collector):
    def count(slips, unknown_senders, frames):
        link = gateway(transmit=SenderMetrics(frames=frames))
        metrics = (
            sm.LoopMetrics(slips=slips),
            SocketMetrics(unknown_senders=unknown_senders),
            link,
        )
        publish(collector, "ground_gateway", START_NS, metrics=metrics)

    count(5, {}, 4)
    count(7, {"radio": 2}, 10)
    metrics = collector.process("ground_gateway")
    assert metrics.total(sm.LoopMetrics).slips == 7
    metrics.handle_end()
    assert metrics.total(sm.LoopMetrics).slips == 7
    assert metrics.link is None
    count(2, {"radio": 1, "haptic": 4}, 3)
    assert metrics.total(sm.LoopMetrics).slips == 9
    assert metrics.total(SocketMetrics).unknown_senders == {"radio": 3, "haptic": 4}
    assert [boot_id.transmit.frames for boot_id in metrics.links()] == [10, 3]
    assert metrics.find(SamplesReceived) is None
    assert metrics.total(SamplesReceived).received == 0


def test_a_picture_is_compared_with_the_force_of_its_own_instant(collector):
    # Half a second of force in one report, with a growing latency.
    instants = [(k, START_NS + k * NS_PER_MS) for k in range(500)]
    felt = [(k, sent_ns + (2 + k // 10) * NS_PER_MS) for k, sent_ns in instants]
    publish(collector, "joystick", START_NS + NS_PER_S, *starmap(sm.SampleReceivedRow, felt))
    publish(collector, "robot", START_NS + NS_PER_S, *starmap(sm.SampleSentRow, instants))
    show(collector, "uplink_video", 132, 50)
    show(collector, "uplink_video", 462, 50)
    collector.handle_end()
    # At 132 ms the sample of 118 ms was felt, 13 ms old; at 462 ms that of 418 ms, 43 ms old.
    summary = collector.skews["video_haptic"].summary_ms()
    assert summary.count == 2
    assert summary.max == pytest.approx(50 - 13, abs=2.5)
    assert summary.p50 == pytest.approx(50 - 43, abs=2.5)
    rate = collector.haptics["up"].rate
    assert rate.octets == 500 * 12
    # One value in 20 ms, not in each millisecond, to spare the launcher.
    assert rate.events < 35


def test_a_restarted_robot_has_no_latencies_of_its_previous_life(collector):
    for begun_ms, told_ms in ((0, 3000), (5000, 5500)):
        sent = [(k, at) for k, at in enumerate(ms(*range(begun_ms, told_ms)))]
        # Every tenth sample of the first life is lost. The receiver reports first.
        felt = [(k, at + 3 * NS_PER_MS) for k, at in sent if begun_ms or k % 10]
        (now_ns,) = ms(told_ms + 100)
        publish(collector, "joystick", now_ns, *starmap(sm.SampleReceivedRow, felt))
        publish(collector, "robot", now_ns, *starmap(sm.SampleSentRow, sent))
        show(collector, "uplink_video", told_ms - 10, 40)
    # The next message matches the waiting stamps.
    feel(collector, 5600, 3)
    collector.handle_end()
    force = collector.haptics["up"].latency
    assert (force.count, force.max) == (2700 + 500 + 1, 3 * NS_PER_MS)
    skew = collector.skews["video_haptic"].summary_ms()
    assert [skew.p50, skew.max] == pytest.approx([37, 37], rel=0.01)


def test_a_process_is_silent_since_its_last_picture_and_keeps_what_was_told():
    process = ProcessMetrics()
    assert process.silent_ns(START_NS) == 0
    for now_ns in ms(0, 500, 1000):
        process.handle_message(message(), now_ns)
    assert (process.began_ns, process.told_ns) == tuple(ms(0, 1000))
    # It has captured nothing since it began.
    assert process.silent_ns() == NS_PER_S
    captured_ns, now_ns = ms(900, 1500)
    process.handle_message(message(CaptureMetrics(captured_ns=captured_ns)), now_ns)
    assert (process.capture.captured_ns, process.gives_since_ns) == (captured_ns, captured_ns)
    assert process.silent_ns() == 600 * NS_PER_MS
    assert process.silent_ns(captured_ns - 1) == 0
    # A gauge that a new start does not know yet keeps its value.
    process.handle_end()
    process.handle_message(message(CaptureMetrics(source_fault="a gap")), now_ns)
    capture = process.capture
    assert (capture.captured_ns, capture.source_fault) == (captured_ns, "a gap")
    process = ProcessMetrics()
    first = message(scheduler="fifo", last_error="broken")
    worse = replace(first, scheduler="other", last_error="worse")
    told = []
    for one in (first, message(), worse):
        process.handle_message(one, START_NS)
        told.append((process.scheduler, process.last_error))
    assert told == [("fifo", "broken"), ("fifo", "broken"), ("other", "worse")]


def test_an_input_gives_since_its_last_pause_and_a_camera_is_selected_since_its_choice():
    camera, selector, since = ProcessMetrics(), ProcessMetrics(), []
    for captured_ns in ms(0, 500, 2000, 3501, 4000):
        camera.handle_message(message(CaptureMetrics(captured_ns=captured_ns)), captured_ns)
        since.append((camera.gives_since_ns - START_NS) // NS_PER_MS)
    # Three reports, 1.5 s, are no pause yet.
    assert since == [0, 0, 0, 3501, 3501]
    since.clear()
    for now_ns, name in zip(ms(0, 500, 1000), ("left", "left", "head"), strict=True):
        selector.handle_message(message(SelectorMetrics(selected=name)), now_ns)
        since.append(selector.selected_ns)
    assert since == ms(0, 0, 1000)
