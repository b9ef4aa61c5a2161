"""Queues: depth, age, drops by policy, RTCP before media, and limited rates."""

import pytest

from kontur_av.errors import ConfigError
from telepresence.link.queues import (
    LEAST_CHARGE_OCTETS,
    MOST_EXPIRED,
    DropPolicy,
    PacketQueue,
    QueueLimits,
)

MS = 1_000_000


def queue(policy, depth_octets=100, max_age_ns=50 * MS, **limits):
    return PacketQueue(
        QueueLimits(depth_octets=depth_octets, max_age_ns=max_age_ns, policy=policy, **limits)
    )


def taken(packets, now_ns=0):
    out = []
    while packets.waiting(now_ns):
        out.append(packets.take(now_ns)[1])
        packets.finish(now_ns)
    return out


def test_reject_newest():
    packets = queue(DropPolicy.REJECT_NEWEST)
    assert packets.handle_packet(0, b"a" * 60, 0)
    assert not packets.handle_packet(0, b"b" * 60, 0)
    assert packets.handle_packet(0, b"c" * 40, 0)
    assert packets.report(0).drops == {"full": 1, "expired": 0, "signal_lost": 0}
    assert taken(packets) == [b"a" * 60, b"c" * 40]


def test_drop_oldest():
    packets = queue(DropPolicy.DROP_OLDEST)
    for octet in b"abc":
        assert packets.handle_packet(0, bytes([octet]) * 40, 0)
    assert taken(packets) == [b"b" * 40, b"c" * 40]
    assert not packets.handle_packet(0, b"x" * 101, 0)
    assert packets.report(0).drops == {"full": 2, "expired": 0, "signal_lost": 0}


def test_too_old_is_dropped_and_counted():
    packets = queue(DropPolicy.DROP_OLDEST)
    packets.handle_packet(0, b"quite old", 0)
    packets.handle_packet(0, b"still young", 10 * MS)
    assert packets.waiting(50 * MS)
    report = packets.report(55 * MS)
    assert report.drops == {"full": 0, "expired": 1, "signal_lost": 0}
    assert (report.packets, report.octets, report.oldest_age_ns) == (1, 11, 45 * MS)
    assert (report.max_octets, report.max_age_ns) == (20, 50 * MS)
    assert taken(packets, 60 * MS) == [b"still young"]


def test_patience_applies_only_if_shorter_than_the_limit():
    packets = queue(DropPolicy.REJECT_NEWEST)
    packets.set_patience(20 * MS)
    packets.handle_packet(0, b"old", 0)
    packets.handle_packet(0, b"young", 10 * MS)
    assert taken(packets, 25 * MS) == [b"young"]
    packets.set_patience(None)
    packets.handle_packet(0, b"patient", 30 * MS)
    assert taken(packets, 70 * MS) == [b"patient"]
    packets.set_patience(1000 * MS)
    packets.handle_packet(0, b"expired", 100 * MS)
    assert taken(packets, 151 * MS) == []
    assert packets.report(0).drops == {"full": 0, "expired": 1, "signal_lost": 1}


def test_flush():
    packets = queue(DropPolicy.REJECT_NEWEST)
    packets.handle_packet(0, b"begun", 0)
    assert packets.waiting(0)
    packets.take(0)
    packets.handle_packet(0, b"too old", 0)
    packets.handle_packet(0, b"waiting", 40 * MS)
    packets.flush(50 * MS)
    report = packets.report(50 * MS)
    assert report.drops == {"full": 0, "expired": 0, "signal_lost": 3}
    assert (report.packets, report.octets, report.max_age_ns) == (0, 0, 50 * MS)
    assert not packets.continues(50 * MS)
    packets.handle_packet(0, b"too old", 60 * MS)
    packets.handle_packet(0, b"waiting", 100 * MS)
    packets.flush(120 * MS)
    assert packets.report(120 * MS).drops == {"full": 0, "expired": 1, "signal_lost": 4}


def test_a_packet_that_was_begun_ages_from_its_arrival():
    packets = queue(DropPolicy.DROP_OLDEST)
    packets.handle_packet(0, b"trickling", 0)
    assert packets.waiting(30 * MS)
    packets.take(30 * MS)
    assert packets.report(45 * MS).oldest_age_ns == 45 * MS
    assert packets.continues(50 * MS)
    assert not packets.continues(51 * MS)
    report = packets.report(60 * MS)
    assert report.drops == {"full": 0, "expired": 1, "signal_lost": 0}
    assert (report.oldest_age_ns, report.max_age_ns) == (0, 50 * MS)


def test_the_largest_age_is_that_of_the_last_octet():
    packets = queue(DropPolicy.DROP_OLDEST)
    packets.handle_packet(0, b"in parts", 0)
    assert packets.waiting(10 * MS)
    packets.take(10 * MS)
    assert packets.continues(35 * MS)
    packets.finish(35 * MS)
    assert packets.report(40 * MS).max_age_ns == 35 * MS


def test_a_packet_that_cannot_end_in_time_is_not_begun():
    """The packet before took 20 ms, so one that is 40 of at most 50 ms old would be dropped."""
    packets = queue(DropPolicy.DROP_OLDEST)
    for begun_ms in (0, 30):
        packets.handle_packet(0, bytes(40), begun_ms * MS)
    packets.handle_packet(0, bytes(20), 30 * MS)
    assert packets.waiting(0)
    packets.take(0)
    packets.finish(20 * MS)
    assert packets.waiting(70 * MS)
    assert len(packets.take(70 * MS)[1]) == 20
    assert packets.report(70 * MS).drops["expired"] == 1


def test_a_fresh_packet_is_begun_however_slow_the_level_was():
    packets = queue(DropPolicy.DROP_OLDEST)
    packets.handle_packet(0, bytes(10), 0)
    assert packets.waiting(0)
    packets.take(0)
    assert not packets.continues(1000 * MS)
    packets.handle_packet(0, bytes(100), 1000 * MS)
    assert packets.waiting(1025 * MS)
    assert not packets.waiting(1026 * MS)


@pytest.mark.parametrize("policy", DropPolicy)
def test_packets_without_octets_fill_a_queue(policy):
    packets = queue(policy, depth_octets=10_000, depth_packets=20)
    for number in range(300):
        packets.handle_packet(0, b"", number)
    report = packets.report(300)
    assert (report.packets, report.max_packets, report.depth_packets) == (20, 20, 20)
    assert report.octets == 20 * LEAST_CHARGE_OCTETS
    assert report.drops["full"] == 280
    packets = queue(policy, depth_octets=100, depth_packets=1000)
    for number in range(300):
        packets.handle_packet(0, b"", number)
    assert len(packets) == 100 // LEAST_CHARGE_OCTETS
    assert packets.report(300).max_octets <= 100


def test_a_slot_drops_a_limited_number_of_old_packets():
    packets = queue(DropPolicy.REJECT_NEWEST, depth_octets=10_000, depth_packets=1000)
    for _ in range(1000):
        packets.handle_packet(0, b"", 0)
    for slot in range(100, 200):
        before = len(packets)
        for _ in range(10):
            assert not packets.waiting(slot * MS)
        assert before - len(packets) == min(MOST_EXPIRED, before)
    packets.handle_packet(0, b"next", 200 * MS)
    assert taken(packets, 200 * MS) == [b"next"]
    assert packets.report(200 * MS).drops["expired"] == 1000


def test_rtcp_goes_before_media_but_not_twice_in_a_row():
    packets = queue(DropPolicy.DROP_OLDEST)
    for data in (b"media 1", b"media 2"):
        packets.handle_packet(0, data, 0)
    for data in (b"rtcp 1", b"rtcp 2", b"rtcp 3", b"rtcp 4"):
        packets.handle_packet(1, data, 0, rtcp=True)
    order = [b"rtcp 1", b"media 1", b"rtcp 2", b"media 2", b"rtcp 3", b"rtcp 4"]
    assert taken(packets) == order


def test_media_is_dropped_for_rtcp_which_has_half_of_the_queue():
    packets = queue(DropPolicy.DROP_OLDEST)
    for octet in range(4):
        packets.handle_packet(0, bytes([octet]) * 25, 0)
    for octet in range(4, 8):
        packets.handle_packet(1, bytes([octet]) * 25, 0, rtcp=True)
    for octet in range(8, 10):
        packets.handle_packet(0, bytes([octet]) * 25, 0)
    assert sorted(data[0] for data in taken(packets)) == [6, 7, 8, 9]
    assert packets.report(0).drops["full"] == 6


def test_a_full_queue_that_rejects_the_newest_also_rejects_rtcp():
    packets = queue(DropPolicy.REJECT_NEWEST)
    assert packets.handle_packet(1, bytes(50), 0, rtcp=True)
    assert not packets.handle_packet(1, bytes(10), 0, rtcp=True)
    assert packets.handle_packet(0, bytes(50), 0)
    assert not packets.handle_packet(0, bytes(10), 0)
    assert packets.report(0).drops["full"] == 2


def test_what_exceeds_the_rate_waits_and_is_counted():
    """8 kbit/s are an octet a millisecond; 20 octets may go at once."""
    packets = queue(DropPolicy.REJECT_NEWEST, rate_bps=8_000, burst_octets=20)
    for number in range(4):
        packets.handle_packet(0, bytes([number]) * 10, 0)
    sent = {}
    for ms in range(30):
        for data in taken(packets, ms * MS):
            sent[data[0]] = ms
    assert sent == {0: 0, 1: 0, 2: 10, 3: 20}
    assert packets.report(30 * MS).delayed == 2
    assert packets.report(30 * MS).max_age_ns == 20 * MS


def test_unused_octets_take_what_the_rate_holds_back_and_are_not_charged():
    packets = queue(DropPolicy.REJECT_NEWEST, rate_bps=8_000, burst_octets=20)
    for number in range(4):
        packets.handle_packet(0, bytes([number]) * 20, 0)
    assert taken(packets, 0) == [bytes(20)]
    assert not packets.waiting(0)
    assert packets.held(0)
    assert packets.take(0)[1] == bytes([1]) * 20
    packets.finish(0)
    assert packets.report(0).delayed == 0
    assert taken(packets, 19 * MS) == []
    assert taken(packets, 20 * MS) == [bytes([2]) * 20]


def test_limits_that_cannot_work_are_refused():
    for wrong in (
        {"depth_octets": 0},
        {"depth_packets": 0},
        {"max_age_ns": 0},
        {"rate_bps": 8_000},
        {"burst_octets": 100},
        {"rate_bps": 0, "burst_octets": 100},
        {"rate_bps": 8_000, "burst_octets": -1},
    ):
        with pytest.raises(ConfigError):
            queue(DropPolicy.DROP_OLDEST, **wrong)
