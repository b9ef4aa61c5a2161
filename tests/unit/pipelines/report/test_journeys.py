"""Which stamps are joined, and what becomes of pauses, rates and restarts."""

import pickle
from itertools import permutations

import numpy as np
import pytest
from told import message

from kontur_av.clock import NS_PER_MS, NS_PER_S
from pipelines.report.collector import Collector
from pipelines.report.journeys import STAGES, HapticMetrics, LipSyncShare, Pauses, StreamMetrics
from pipelines.session import session_metrics as sm
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.table import topology_of

SESSION = topology_of(BUILT_IN["spacejustin"])
START_NS = 1_000 * NS_PER_S
PERIOD_MS = 40


def publish(collector, process, *rows, stream=""):
    collector.handle_message(process, message(rows=rows, stream=stream), 10 * NS_PER_S)


def ns(*values_ms):
    return [value * NS_PER_MS for value in values_ms]


def at(*values_ms):
    return [START_NS + round(value * NS_PER_MS) for value in values_ms]


def rows(*values):
    return np.array(values, np.int64)


@pytest.mark.parametrize("order", list(permutations(range(3))))
def test_the_stages_of_a_picture_are_joined_in_any_order_of_messages(order):
    collector = Collector(SESSION)
    coding, sent, received, decoded, shown = [], [], [], [], []
    for number in range(3):
        captured = 1000 + PERIOD_MS * number
        at = [captured + step for step in (0, 4, 5, 11, 12, 46, 49, 50)]
        coding.append(sm.CodingRow(number, *ns(at[1], at[2]), 240, 2))
        sent.append(sm.TxRow(number, *ns(at[0], at[3], at[4])))
        received.append(sm.RxRow(number, *ns(at[5])))
        decoded.append(sm.DecodedRow(number, *ns(at[6])))
        shown.append(sm.ShownRow(number, *ns(at[0], at[7])))
    messages = [
        ("uplink_video_send", [*coding, *sent], ""),
        ("uplink_video_receive", [*decoded, *received], ""),
        ("space_display", shown, "uplink_video"),
    ]
    for index in order:
        process, rows, stream = messages[index]
        publish(collector, process, *rows, stream=stream)
    metrics = collector.streams["uplink_video"]
    stages = [metrics.stages[stage] for stage in STAGES]
    assert [stage.max for stage in stages] == ns(11, 1, 34, 4)
    assert [stage.count for stage in stages] == [3] * 4
    assert metrics.latency.max == 50 * NS_PER_MS
    assert collector.streams["uplink_voice"].latency.count == 0
    # The first picture has no weight, because no picture came before it.
    way = metrics.way
    assert way.pictures == 2
    parts = ("camera", "capture", "waiting", "encoding", "network", "decoding", "display", "total")
    found = [way.mean_ns(part) / NS_PER_MS for part in parts]
    assert found == [PERIOD_MS / 2, 4, 1, 6, 35, 3, 1, 50 + PERIOD_MS / 2]
    assert (way.octets_mean, way.packets_mean) == (240, 2)


def test_a_pause_of_the_camera_is_not_counted_as_a_period():
    collector = Collector(SESSION)
    coding = sm.CodingRow(2, *ns(5000, 5000), 9, 1)
    publish(collector, "uplink_video_send", coding, sm.TxRow(2, *ns(5000) * 3))
    publish(collector, "uplink_video_receive", sm.RxRow(2, *ns(5010)))
    shown = sm.ShownRow(1, *ns(10, 20)), sm.ShownRow(2, *ns(5000, 5020))
    publish(collector, "space_display", *shown, stream="uplink_video")
    assert collector.streams["uplink_video"].way.pictures == 0


def test_pauses_are_kept_with_begin_and_end_the_newest_thousand_of_them():
    collector = Collector(SESSION)
    shown = [sm.ShownRow(n, *ns(end - 40, end)) for n, end in enumerate((100, 1100, 2101, 2140))]
    felt = [sm.SampleReceivedRow(n, *ns(end)) for n, end in enumerate((1, 2, 202, 403, 404, 900))]
    for half in (slice(0, 3), slice(3, None)):
        publish(collector, "space_display", *shown[half], stream="uplink_video")
        publish(collector, "joystick", *felt[half])
    assert list(collector.streams["uplink_video"].pauses.ended_ns) == [tuple(ns(1100, 2101))]
    pauses = [tuple(ns(202, 403)), tuple(ns(404, 900))]
    assert list(collector.haptics["up"].pauses.ended_ns) == pauses
    assert not collector.haptics["down"].pauses.ended_ns
    pauses = Pauses(100)
    assert pauses.within(0, 101) == [(0, 101)]
    assert pauses.within(0, 100) == []
    for instant in (50, 150, 251, 300):
        pauses.add(instant)
    pauses.add_all(rows(400, 501, 601, 750))
    ended = [(150, 251), (400, 501), (601, 750)]
    assert pauses.within(0, 850) == ended
    assert pauses.within(-51, 851) == [(-51, 50), *ended, (750, 851)]
    assert (pauses.first_ns, pauses.last_ns) == (50, 750)
    many = Pauses(1)
    for number in range(1003):
        many.add(10 * number)
    kept = many.within(0, 10 * 1002)
    assert (len(kept), kept[0]) == (1000, (20, 30))


def test_the_metrics_of_a_longer_session_take_no_more_memory():
    collector, sizes = Collector(SESSION), {}
    for second in range(120):
        begin_ns = second * NS_PER_S
        sent = [((1000 * second + k) % 65_536, begin_ns + k * NS_PER_MS) for k in range(1000)]
        felt = [sm.SampleReceivedRow(number, at + 3 * NS_PER_MS) for number, at in sent]
        shown = [sm.ShownRow(at // NS_PER_MS, at, at + 50 * NS_PER_MS) for _, at in sent[::20]]
        for process, told, stream in (
            ("robot", [sm.SampleSentRow(*row) for row in sent], ""),
            ("joystick", felt, ""),
            ("space_display", shown, "uplink_video"),
        ):
            one = message(rows=told, stream=stream)
            collector.handle_message(process, one, begin_ns + NS_PER_S)
        sizes[second] = len(pickle.dumps((collector.streams, collector.haptics, collector.skews)))
    assert collector.haptics["up"].latency.count >= 119_000
    assert sizes[119] < 1.02 * sizes[59]


def felt(haptic, *samples, delay_ms=3):
    """Samples (number, sent at ms) come after `delay_ms`, told by both ends in one batch."""
    sent = [(number, START_NS + ms * NS_PER_MS) for number, ms in samples]
    received = [(number, sent_ns + delay_ms * NS_PER_MS) for number, sent_ns in sent]
    haptic.handle_sent(rows(*sent), received[-1][1])
    haptic.handle_received(rows(*received), received[-1][1])


def test_the_newest_sample_at_an_instant_is_the_last_received_and_each_counts_once():
    haptic = HapticMetrics(12)
    haptic.handle_received(np.empty((0, 2), np.int64), START_NS)
    assert haptic.pauses.last_ns is None, "a batch without samples changes nothing"
    felt(haptic, (10, 100), (11, 101), (12, 102))
    felt(haptic, (13, 110), (14, 111))
    # Received at 103, 104, 105; 113 and 114 ms.
    instants_ms = (102.9, 103, 103.9, 104, 105, 112.9, 113, 113.5, 114, 900)
    newest = [haptic.sent_ns_at(one) for one in at(*instants_ms)]
    assert newest[0] is None
    assert newest[1:] == at(100, 100, 101, 102, 102, 110, 110, 111, 111)
    haptic = HapticMetrics(12)
    felt(haptic, (7, 0))
    assert haptic.sent_ns_at(START_NS + 30 * NS_PER_S - 1) == START_NS
    # 30 s later the same number may be another sample's.
    assert haptic.sent_ns_at(START_NS + 30 * NS_PER_S) is None
    assert HapticMetrics(12).sent_ns_at(START_NS + 3 * NS_PER_MS) is None
    haptic = HapticMetrics(12)
    felt(haptic, *[(number, number) for number in range(100)])
    assert haptic.rate.octets == 100 * 12
    # A restarted end's first report may overtake its predecessor's last.
    felt(haptic, *[(number, number + 50) for number in range(10)])
    assert haptic.rate.octets == 110 * 12
    assert haptic.rate.last_ns >= at(100)[0]


RIGHT = {"captured": 0, "encoded": 5, "sent": 9, "received": 20, "displayed": 30}


def journey(stream, timestamp, **changed_ms):
    instants = {name: START_NS + ms * NS_PER_MS for name, ms in (RIGHT | changed_ms).items()}
    now_ns = max(instants.values())
    captured, encoded, sent, received, displayed = instants.values()
    for row in (
        sm.TxRow(timestamp, captured, encoded, sent),
        sm.RxRow(timestamp, received),
        sm.ShownRow(timestamp, captured, displayed),
    ):
        stream.handle_rows(type(row), rows(row), now_ns)


def test_a_negative_stage_is_counted_by_its_name_and_each_picture_is_joined_once():
    stream = StreamMetrics()
    journey(stream, 1)
    assert stream.negative() == {}
    journey(stream, 2, received=8)
    journey(stream, 3, captured=40, displayed=39)
    names = ("capture_to_displayed", "capture_to_encoded", "sent_to_received")
    assert stream.negative() == dict.fromkeys(names, 1)
    assert stream.last_latency_ns == -NS_PER_MS
    assert stream.pauses.last_ns == START_NS + 39 * NS_PER_MS
    assert [latency_ns // NS_PER_MS for _, latency_ns in stream.fresh] == [30, 30, -1]
    stream = StreamMetrics()
    journey(stream, 1)
    journey(stream, 1)
    # The same timestamp again is another picture's, after 13 hours.
    assert stream.stages["capture_to_encoded"].count == 2
    stream.handle_rows(sm.RxRow, rows(sm.RxRow(1, START_NS)), START_NS)
    assert stream.stages["capture_to_encoded"].count == 2


@pytest.mark.parametrize(
    ("between", "wait_s", "joined"), [(1999, 0, 1), (2000, 0, 0), (1, 10, 1), (1, 10.001, 0)]
)
def test_2000_pictures_wait_ten_seconds_for_their_other_end(between, wait_s, joined):
    stream = StreamMetrics()
    later_ns = START_NS + round(wait_s * NS_PER_S)
    stream.handle_rows(sm.TxRow, rows(sm.TxRow(5, START_NS, START_NS, START_NS)), START_NS)
    received = [sm.RxRow(100 + n, later_ns) for n in range(between)]
    stream.handle_rows(sm.RxRow, rows(*received), later_ns)
    stream.handle_rows(sm.RxRow, rows(sm.RxRow(5, later_ns)), later_ns)
    stream.handle_shown(rows(sm.ShownRow(5, START_NS, later_ns)), later_ns)
    assert stream.stages["capture_to_encoded"].count == joined


def test_the_share_of_lip_sync_counts_time_and_the_largest_excess_over_the_cap_is_kept():
    share = LipSyncShare()
    # A second in sync, a tenth too early, two tenths too late.
    for at_ms, skew_ms in ((0, -45), (500, 125), (1000, -46), (1100, 126), (1300, 0)):
        share.add(at_ms * NS_PER_MS, skew_ms * NS_PER_MS)
    summary = share.summary()
    found = summary.within, summary.early, summary.late
    assert found == pytest.approx((1000 / 1300, 100 / 1300, 200 / 1300), abs=1e-5)
    # A picture that is never replaced counts for half a second.
    share.add(100 * NS_PER_S, 0)
    assert share.counted_ns == 1800 * NS_PER_MS
    stream = StreamMetrics()
    first, second, third, later = at(0, 100, 200, 5000)
    stream.handle_out(rows(sm.OutRow(first, 1000, 16_000), sm.OutRow(second, 1500, 16_000)))
    assert stream.above_cap_bps == (20_000 - 16_000, 20_000)
    # The cap has grown, so the larger rate is less above it.
    stream.handle_out(rows(sm.OutRow(third, 1000, 32_000), sm.OutRow(later, 100, 16_000)))
    assert stream.above_cap_bps == (4_000, 20_000)
