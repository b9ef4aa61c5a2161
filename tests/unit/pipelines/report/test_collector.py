"""The collector joins and compares the reports of processes, and adds them over restarts."""

from itertools import permutations, starmap

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from told import gateway, message

from kontur_av.clock import NS_PER_MS, NS_PER_S
from pipelines.link.figures import SocketFigures
from pipelines.media.figures import CaptureFigures
from pipelines.report.collector import Collector
from pipelines.report.journeys import STAGES, Skew
from pipelines.session.figures import (
    LoopFigures,
    OutRow,
    RxRow,
    SampleReceivedRow,
    SampleSentRow,
    ShownRow,
    TxRow,
)
from pipelines.session.probe import Message
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.table import topology_of
from telepresence.haptics.figures import SamplesReceived
from telepresence.link.figures import SenderFigures

SESSION = topology_of(BUILT_IN["spacejustin"])
START_NS = 1_000 * NS_PER_S


def tell(collector, process, now_ns, *rows, stream="", figures=()):
    told = message(*figures, rows=rows, stream=stream)
    collector.handle_message(process, Message.unpack(told.pack()), now_ns)


def ms(*values):
    return [START_NS + value * NS_PER_MS for value in values]


@pytest.mark.parametrize("order", list(permutations(range(3))))
def test_stages_are_joined_by_timestamp_in_any_order_of_messages(order):
    collector = Collector(SESSION)
    captured, encoded, sent, received, displayed = ms(0, 5, 12, 30, 47)
    messages = [
        ("uplink_video_send", TxRow(77, captured, encoded, sent), ""),
        ("uplink_video_receive", RxRow(77, received), ""),
        ("space_display", ShownRow(77, captured, displayed), "uplink_video"),
    ]
    for index in order:
        process, row, stream = messages[index]
        tell(collector, process, displayed, row, stream=stream)
    figures = collector.streams["uplink_video"]
    stages = [figures.stages[stage] for stage in STAGES]
    assert [stage.max for stage in stages] == [value * NS_PER_MS for value in (5, 7, 18, 17)]
    assert [stage.count for stage in stages] == [1] * 4
    assert figures.latency.max == 47 * NS_PER_MS
    assert collector.streams["uplink_voice"].latency.count == 0


def test_a_picture_with_a_missing_stage_has_a_latency_but_no_stages():
    collector = Collector(SESSION)
    captured, displayed = ms(0, 20)
    tell(
        collector,
        "space_display",
        displayed,
        ShownRow(1, captured, displayed),
        stream="uplink_video",
    )
    tell(collector, "uplink_video_receive", displayed, RxRow(2, displayed))
    figures = collector.streams["uplink_video"]
    assert figures.latency.count == 1
    assert all(stage.count == 0 for stage in figures.stages.values())


def test_unmatched_stamps_are_forgotten_after_a_while():
    collector = Collector(SESSION)
    (sent,) = ms(0)
    tell(collector, "uplink_video_send", sent, TxRow(5, sent, sent, sent))
    late = sent + 60 * NS_PER_S
    tell(collector, "uplink_video_receive", late, RxRow(6, late), RxRow(5, late))
    tell(collector, "space_display", late, ShownRow(5, sent, late), stream="uplink_video")
    stages = collector.streams["uplink_video"].stages
    assert all(stage.count == 0 for stage in stages.values())


def test_the_transmitted_capture_time_is_compared_with_the_original_stamp():
    collector = Collector(SESSION)
    captured, displayed = ms(0, 20)
    tell(collector, "uplink_video_send", displayed, TxRow(9, captured, captured, captured))
    row = ShownRow(9, captured + 40_000, displayed)
    tell(collector, "space_display", displayed, row, stream="uplink_video")
    assert collector.streams["uplink_video"].stamp_error.max == 40_000


def feel(collector, at_ms, latency_ms):
    """A force that was measured `latency_ms` before it was displayed to the hand."""
    (received,) = ms(at_ms)
    sent = received - latency_ms * NS_PER_MS
    tell(collector, "robot", received, SampleSentRow(at_ms, sent))
    tell(collector, "joystick", received, SampleReceivedRow(at_ms, received))


def show(collector, stream, at_ms, latency_ms):
    (displayed,) = ms(at_ms)
    row = ShownRow(at_ms, displayed - latency_ms * NS_PER_MS, displayed)
    tell(collector, "space_display", displayed, row, stream=stream)


def test_the_skew_of_a_late_sense_is_positive():
    collector = Collector(SESSION)
    feel(collector, 100, 2)
    show(collector, "uplink_voice", 110, 30)
    show(collector, "uplink_video", 120, 52)
    collector.handle_end()
    skews = {name: skew.summary_ms().p50 for name, skew in collector.skews.items()}
    assert skews["video_haptic"] == pytest.approx(50, rel=0.01)
    assert skews["audio_haptic"] == pytest.approx(28, rel=0.01)
    # The voice came before the picture of the same instant.
    assert skews["audio_video"] == pytest.approx(-22, rel=0.01)


def test_silent_senses_are_not_compared():
    collector = Collector(SESSION)
    feel(collector, 100, 2)
    show(collector, "uplink_video", 1200, 52)
    collector.handle_end()
    assert all(skew.count == 0 for skew in collector.skews.values())


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


def test_the_counts_of_a_restarted_process_are_added():
    def count(slips, strangers, frames):
        link = gateway(transmit=SenderFigures(frames=frames))
        figures = LoopFigures(slips=slips), SocketFigures(strangers=strangers)
        figures = *figures, link
        tell(collector, "ground_gateway", START_NS, figures=figures)

    collector = Collector(SESSION)
    count(5, {}, 4)
    count(7, {"radio": 2}, 10)
    figures = collector.process("ground_gateway")
    assert figures.total(LoopFigures).slips == 7
    figures.handle_end()
    assert figures.total(LoopFigures).slips == 7
    assert figures.link is None
    count(2, {"radio": 1, "haptic": 4}, 3)
    assert figures.total(LoopFigures).slips == 9
    assert figures.total(SocketFigures).strangers == {"radio": 3, "haptic": 4}
    assert [life.transmit.frames for life in figures.links()] == [10, 3]
    assert figures.find(SamplesReceived) is None
    assert figures.total(SamplesReceived).received == 0


def test_a_gauge_that_a_new_life_does_not_know_yet_keeps_its_value():
    collector = Collector(SESSION)
    first = CaptureFigures(captured_ns=START_NS, source_fault="a pause")
    tell(collector, "camera_head", START_NS, figures=[first])
    collector.process("camera_head").handle_end()
    tell(collector, "camera_head", START_NS, figures=[CaptureFigures(source_fault="a gap")])
    figures = collector.process("camera_head")
    assert (figures.capture.captured_ns, figures.capture.source_fault) == (START_NS, "a gap")


CAP_BPS = 90_000


def test_a_restarted_sender_has_one_rate_over_both_lives():
    collector = Collector(SESSION)
    first, second, overtaken = ms(0, 500, 400)
    tell(
        collector,
        "uplink_video_send",
        second,
        OutRow(first, 1000, CAP_BPS),
        OutRow(second, 1000, CAP_BPS),
    )
    collector.process("uplink_video_send").handle_end()
    tell(collector, "uplink_video_send", second, OutRow(overtaken, 1000, CAP_BPS))
    assert collector.streams["uplink_video"].rate.max_bps() == 24_000


def test_a_picture_is_compared_with_the_force_of_its_own_instant():
    collector = Collector(SESSION)
    # Half a second of force in one report, with a growing latency.
    instants = [(k, START_NS + k * NS_PER_MS) for k in range(500)]
    felt = [(k, sent_ns + (2 + k // 10) * NS_PER_MS) for k, sent_ns in instants]
    tell(collector, "joystick", START_NS + NS_PER_S, *starmap(SampleReceivedRow, felt))
    tell(collector, "robot", START_NS + NS_PER_S, *starmap(SampleSentRow, instants))
    show(collector, "uplink_video", 132, 50)
    show(collector, "uplink_video", 462, 50)
    collector.handle_end()
    skew = collector.skews["video_haptic"]
    # At 132 ms the sample of 118 ms was felt, 13 ms old; at 462 ms that of 418 ms, 43 ms old.
    summary = skew.summary_ms()
    assert skew.count == 2
    assert summary.max == pytest.approx(50 - 13, abs=2.5)
    assert summary.p50 == pytest.approx(50 - 43, abs=2.5)
    rate = collector.haptics["up"].rate
    assert rate.octets == 500 * 12
    # One value in 20 ms, not in each millisecond, to spare the launcher.
    assert rate.events < 35


def test_a_restarted_robot_has_no_latencies_of_its_previous_life():
    collector = Collector(SESSION)
    for begun_ms, told_ms in ((0, 3000), (5000, 5500)):
        sent = [(k, at) for k, at in enumerate(ms(*range(begun_ms, told_ms)))]
        # Every tenth sample of the first life is lost. The receiver reports first.
        felt = [(k, at + 3 * NS_PER_MS) for k, at in sent if begun_ms or k % 10]
        (now_ns,) = ms(told_ms + 100)
        tell(collector, "joystick", now_ns, *starmap(SampleReceivedRow, felt))
        tell(collector, "robot", now_ns, *starmap(SampleSentRow, sent))
        show(collector, "uplink_video", told_ms - 10, 40)
    # The next message matches the waiting stamps.
    feel(collector, 5600, 3)
    collector.handle_end()
    force = collector.haptics["up"].latency
    assert (force.count, force.max) == (2700 + 500 + 1, 3 * NS_PER_MS)
    skew = collector.skews["video_haptic"].summary_ms()
    assert [skew.p50, skew.max] == pytest.approx([37, 37], rel=0.01)


def test_force_without_a_stamp_of_its_sender_is_ignored():
    collector = Collector(SESSION)
    feel(collector, 100, 2)
    (lost_ns,) = ms(200)
    tell(collector, "joystick", lost_ns, SampleReceivedRow(200, lost_ns))
    feel(collector, 300, 4)
    show(collector, "uplink_video", 310, 50)
    collector.handle_end()
    assert collector.skews["video_haptic"].summary_ms().max == pytest.approx(46)
