"""Which stamps the collector joins, and what it makes of pauses, rates and restarts."""

from dataclasses import replace

import numpy as np
import pytest
from told import message

from kontur_av.clock import NS_PER_MS, NS_PER_S
from pipelines.media.figures import CaptureFigures, SelectorFigures
from pipelines.report.collector import ProcessFigures
from pipelines.report.journeys import HapticFigures, Pauses, StreamFigures
from pipelines.session.figures import OutRow, RxRow, ShownRow, TxRow

START_NS = 1_000 * NS_PER_S


def at(*values_ms):
    return [START_NS + round(value * NS_PER_MS) for value in values_ms]


def rows(*values):
    return np.array(values, np.int64)


def felt(haptic, *samples, delay_ms=3):
    """Samples (number, sent at ms) come after `delay_ms`, told by both ends in one batch."""
    sent = [(number, START_NS + ms * NS_PER_MS) for number, ms in samples]
    received = [(number, sent_ns + delay_ms * NS_PER_MS) for number, sent_ns in sent]
    haptic.handle_sent(rows(*sent), received[-1][1])
    haptic.handle_received(rows(*received), received[-1][1])


def test_the_newest_sample_at_an_instant_is_the_last_one_received_by_then():
    haptic = HapticFigures(12)
    felt(haptic, (10, 100), (11, 101), (12, 102))
    felt(haptic, (13, 110), (14, 111))

    def newest_ms(instant_ms):
        sent_ns = haptic.sent_ns_at(START_NS + round(instant_ms * NS_PER_MS))
        return None if sent_ns is None else (sent_ns - START_NS) // NS_PER_MS

    # Received at 103, 104, 105; 113 and 114 ms.
    instants_ms = (102.9, 103, 103.9, 104, 105, 112.9, 113, 113.5, 114, 900)
    assert [newest_ms(ms) for ms in instants_ms] == [
        None, 100, 100, 101, 102, 102, 110, 110, 111, 111
    ]  # fmt: skip


def test_a_number_of_another_turn_is_no_match():
    haptic = HapticFigures(12)
    felt(haptic, (7, 0))
    received_ns = START_NS + 3 * NS_PER_MS
    assert haptic.sent_ns_at(received_ns) == START_NS
    assert haptic.sent_ns_at(START_NS + 30 * NS_PER_S - 1) == START_NS
    # 30 s later the same number may be another sample's.
    assert haptic.sent_ns_at(START_NS + 30 * NS_PER_S) is None
    assert HapticFigures(12).sent_ns_at(received_ns) is None


def test_the_rate_of_samples_counts_each_once():
    haptic = HapticFigures(12)
    felt(haptic, *[(number, number) for number in range(100)])
    assert haptic.rate.octets == 100 * 12
    # A restarted end's first report may overtake its predecessor's last.
    felt(haptic, *[(number, number + 50) for number in range(10)])
    assert haptic.rate.octets == 110 * 12
    assert haptic.rate.last_ns >= at(100)[0]


def test_a_batch_without_samples_changes_nothing():
    haptic = HapticFigures(12)
    haptic.handle_received(np.empty((0, 2), np.int64), START_NS)
    assert haptic.pauses.last_ns is None


def test_pauses_are_those_longer_than_the_least():
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


def test_only_the_newest_thousand_pauses_are_kept():
    pauses = Pauses(1)
    for number in range(1003):
        pauses.add(10 * number)
    kept = pauses.within(0, 10 * 1002)
    assert len(kept) == 1000
    assert kept[0] == (20, 30)


def test_the_largest_excess_over_the_cap_is_kept_with_its_rate():
    stream = StreamFigures()
    first, second, third, later = at(0, 100, 200, 5000)
    stream.handle_out(rows(OutRow(first, 1000, 16_000), OutRow(second, 1500, 16_000)))
    assert stream.above_cap_bps == (20_000 - 16_000, 20_000)
    # The cap has grown, so the larger rate is less above it.
    stream.handle_out(rows(OutRow(third, 1000, 32_000), OutRow(later, 100, 16_000)))
    assert stream.above_cap_bps == (4_000, 20_000)


def journey(stream, timestamp, **instants_ms):
    ns = {name: START_NS + value * NS_PER_MS for name, value in instants_ms.items()}
    now_ns = max(ns.values())
    sent = TxRow(timestamp, ns["captured"], ns["encoded"], ns["sent"])
    stream.handle_rows(TxRow, rows(sent), now_ns)
    stream.handle_rows(RxRow, rows(RxRow(timestamp, ns["received"])), now_ns)
    shown = ShownRow(timestamp, ns["captured"], ns["displayed"])
    stream.handle_rows(ShownRow, rows(shown), now_ns)


def test_a_negative_stage_is_counted_by_its_name():
    stream = StreamFigures()
    right = {"captured": 0, "encoded": 5, "sent": 9, "received": 20, "displayed": 30}
    journey(stream, 1, **right)
    assert stream.negative() == {}
    journey(stream, 2, **right | {"received": 8})
    journey(stream, 3, **right | {"captured": 40, "displayed": 39})
    assert stream.negative() == {
        "capture_to_displayed": 1,
        "capture_to_encoded": 1,
        "sent_to_received": 1,
    }
    assert stream.last_latency_ns == -NS_PER_MS
    assert stream.pauses.last_ns == START_NS + 39 * NS_PER_MS
    assert [latency_ns // NS_PER_MS for _, latency_ns in stream.fresh] == [30, 30, -1]


def test_each_picture_is_joined_once():
    stream = StreamFigures()
    instants = {"captured": 0, "encoded": 5, "sent": 9, "received": 20, "displayed": 30}
    for _ in range(2):
        journey(stream, 1, **instants)
    # The same timestamp again is another picture's, after 13 hours.
    assert stream.stages["capture_to_encoded"].count == 2
    stream.handle_rows(RxRow, rows(RxRow(1, START_NS)), START_NS)
    assert stream.stages["capture_to_encoded"].count == 2


@pytest.mark.parametrize(("between", "joined"), [(1999, 1), (2000, 0)])
def test_no_more_pictures_wait_than_allowed(between, joined):
    stream = StreamFigures()
    stream.handle_rows(TxRow, rows(TxRow(5, START_NS, START_NS, START_NS)), START_NS)
    stream.handle_rows(RxRow, rows(*[RxRow(100 + n, START_NS) for n in range(between)]), START_NS)
    stream.handle_rows(RxRow, rows(RxRow(5, START_NS)), START_NS)
    stream.handle_shown(rows(ShownRow(5, START_NS, START_NS)), START_NS)
    assert stream.stages["capture_to_encoded"].count == joined


@pytest.mark.parametrize(("wait_s", "joined"), [(10, 1), (10.001, 0)])
def test_a_picture_waits_ten_seconds_for_its_other_end(wait_s, joined):
    stream = StreamFigures()
    later_ns = START_NS + round(wait_s * NS_PER_S)
    stream.handle_rows(TxRow, rows(TxRow(5, START_NS, START_NS, START_NS)), START_NS)
    stream.handle_rows(RxRow, rows(RxRow(6, later_ns), RxRow(5, later_ns)), later_ns)
    stream.handle_shown(rows(ShownRow(5, START_NS, later_ns)), later_ns)
    assert stream.stages["capture_to_encoded"].count == joined


def test_the_time_of_a_process_is_that_of_its_messages():
    process = ProcessFigures()
    assert process.silent_ns(START_NS) == 0
    for now_ns in at(0, 500, 1000):
        process.handle_message(message(), now_ns)
    assert (process.began_ns, process.told_ns) == tuple(at(0, 1000))
    # It has captured nothing since it began.
    assert process.silent_ns() == NS_PER_S
    captured_ns, now_ns = at(900, 1500)
    process.handle_message(message(CaptureFigures(captured_ns=captured_ns)), now_ns)
    assert (process.capture.captured_ns, process.gives_since_ns) == (captured_ns, captured_ns)
    assert process.silent_ns() == 600 * NS_PER_MS
    assert process.silent_ns(captured_ns - 1) == 0


def test_an_input_gives_since_its_last_pause():
    process = ProcessFigures()
    since = []
    for captured_ns in at(0, 500, 2000, 3501, 4000):
        process.handle_message(message(CaptureFigures(captured_ns=captured_ns)), captured_ns)
        since.append(process.gives_since_ns)
    # Three reports, 1.5 s, are no pause yet.
    assert [(since_ns - START_NS) // NS_PER_MS for since_ns in since] == [0, 0, 0, 3501, 3501]


def test_a_camera_is_selected_since_its_choice():
    process = ProcessFigures()
    since = []
    for now_ns, name in zip(at(0, 500, 1000), ("left", "left", "head"), strict=True):
        process.handle_message(message(SelectorFigures(selected=name)), now_ns)
        since.append(process.selected_ns)
    assert since == [since[0], since[0], at(1000)[0]]
    assert since[0] == START_NS


def test_a_later_message_without_news_keeps_what_was_told():
    process = ProcessFigures()
    first = message(scheduler="fifo", last_error="broken")
    process.handle_message(first, START_NS)
    process.handle_message(message(), START_NS)
    assert (process.scheduler, process.last_error) == ("fifo", "broken")
    process.handle_message(replace(first, scheduler="other", last_error="worse"), START_NS)
    assert (process.scheduler, process.last_error) == ("other", "worse")
