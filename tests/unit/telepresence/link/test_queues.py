"""Queues: depth, age, drops by policy, RTCP before media, and limited rates."""

import pytest

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ConfigError
from telepresence.link.flows import Level
from telepresence.link.queues import (
    DEFAULT_LIMITS,
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


def put(packets, *octets, now_ns=0, **options):
    """Put a packet of each of these octets or numbers of zeros; return whether each was taken."""
    data = [one if isinstance(one, bytes) else bytes(one) for one in octets]
    return [packets.handle_packet(0, one, now_ns, **options) for one in data]


def taken(packets, now_ns=0):
    out = []
    while packets.waiting(now_ns):
        out.append(packets.take(now_ns)[1])
        packets.finish(now_ns)
    return out


@pytest.mark.rule("4")
def test_a_full_queue_drops_by_its_policy():
    packets = queue(DropPolicy.REJECT_NEWEST)
    assert put(packets, b"a" * 60, b"b" * 60, b"c" * 40) == [True, False, True]
    assert packets.report(0).drops == {"full": 1, "expired": 0, "signal_lost": 0}
    assert taken(packets) == [b"a" * 60, b"c" * 40]
    packets = queue(DropPolicy.DROP_OLDEST)
    assert put(packets, b"a" * 40, b"b" * 40, b"c" * 40) == [True] * 3
    assert taken(packets) == [b"b" * 40, b"c" * 40]
    assert put(packets, 101) == [False]
    assert packets.report(0).drops == {"full": 2, "expired": 0, "signal_lost": 0}


def test_too_old_is_dropped_and_counted():
    packets = queue(DropPolicy.DROP_OLDEST)
    put(packets, b"quite old")
    put(packets, b"still young", now_ns=10 * MS)
    assert packets.waiting(50 * MS)
    report = packets.report(55 * MS)
    assert report.drops == {"full": 0, "expired": 1, "signal_lost": 0}
    assert (report.packets, report.octets, report.oldest_age_ns) == (1, 11, 45 * MS)
    assert (report.max_octets, report.max_age_ns) == (20, 50 * MS)
    assert taken(packets, 60 * MS) == [b"still young"]


def test_patience_applies_only_if_shorter_than_the_limit():
    packets = queue(DropPolicy.REJECT_NEWEST)
    packets.set_timeout(20 * MS)
    put(packets, b"old")
    put(packets, b"young", now_ns=10 * MS)
    assert taken(packets, 25 * MS) == [b"young"]
    for timeout_ns, came_ms, waits_ms in ((None, 30, 40), (1000 * MS, 100, 51)):
        packets.set_timeout(timeout_ns)
        put(packets, b"patient", now_ns=came_ms * MS)
        left = taken(packets, (came_ms + waits_ms) * MS)
        assert left == ([b"patient"] if waits_ms <= 50 else [])
    assert packets.report(0).drops == {"full": 0, "expired": 1, "signal_lost": 1}


def test_a_flush_drops_what_waits_and_what_was_begun():
    packets = queue(DropPolicy.REJECT_NEWEST)
    put(packets, b"begun")
    assert packets.waiting(0)
    packets.take(0)
    put(packets, b"too old")
    put(packets, b"waiting", now_ns=40 * MS)
    packets.flush(50 * MS)
    report = packets.report(50 * MS)
    assert report.drops == {"full": 0, "expired": 0, "signal_lost": 3}
    assert (report.packets, report.octets, report.max_age_ns) == (0, 0, 50 * MS)
    assert not packets.continues(50 * MS)
    put(packets, b"too old", now_ns=60 * MS)
    put(packets, b"waiting", now_ns=100 * MS)
    packets.flush(120 * MS)
    assert packets.report(120 * MS).drops == {"full": 0, "expired": 1, "signal_lost": 4}


def test_a_packet_that_was_begun_ages_from_its_arrival_to_its_last_octet():
    packets = queue(DropPolicy.DROP_OLDEST)
    put(packets, b"in parts")
    assert packets.waiting(10 * MS)
    packets.take(10 * MS)
    assert packets.continues(35 * MS)
    packets.finish(35 * MS)
    assert packets.report(40 * MS).max_age_ns == 35 * MS
    packets = queue(DropPolicy.DROP_OLDEST)
    put(packets, b"trickling")
    assert packets.waiting(30 * MS)
    packets.take(30 * MS)
    assert packets.report(45 * MS).oldest_age_ns == 45 * MS
    assert packets.continues(50 * MS)
    assert not packets.continues(51 * MS)
    report = packets.report(60 * MS)
    assert report.drops == {"full": 0, "expired": 1, "signal_lost": 0}
    assert (report.oldest_age_ns, report.max_age_ns) == (0, 50 * MS)


def test_a_packet_that_cannot_end_in_time_is_not_begun():
    """The packet before took 20 ms, so one that is 40 of at most 50 ms old would be dropped."""
    packets = queue(DropPolicy.DROP_OLDEST)
    put(packets, 40)
    put(packets, 40, 20, now_ns=30 * MS)
    assert packets.waiting(0)
    packets.take(0)
    packets.finish(20 * MS)
    assert packets.waiting(70 * MS)
    assert len(packets.take(70 * MS)[1]) == 20
    assert packets.report(70 * MS).drops["expired"] == 1
    # A fresh one is begun, however slow the level was.
    packets = queue(DropPolicy.DROP_OLDEST)
    put(packets, 10)
    assert packets.waiting(0)
    packets.take(0)
    assert not packets.continues(1000 * MS)
    put(packets, 100, now_ns=1000 * MS)
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
    put(packets, *[0] * 1000)
    for slot in range(100, 200):
        before = len(packets)
        for _ in range(10):
            assert not packets.waiting(slot * MS)
        assert before - len(packets) == min(MOST_EXPIRED, before)
    put(packets, b"next", now_ns=200 * MS)
    assert taken(packets, 200 * MS) == [b"next"]
    assert packets.report(200 * MS).drops["expired"] == 1000


def test_rtcp_goes_before_media_but_not_twice_in_a_row():
    packets = queue(DropPolicy.DROP_OLDEST)
    put(packets, b"media 1", b"media 2")
    put(packets, b"rtcp 1", b"rtcp 2", b"rtcp 3", b"rtcp 4", rtcp=True)
    order = [b"rtcp 1", b"media 1", b"rtcp 2", b"media 2", b"rtcp 3", b"rtcp 4"]
    assert taken(packets) == order


def test_media_is_dropped_for_rtcp_which_has_half_of_the_queue():
    packets = queue(DropPolicy.DROP_OLDEST)
    for first, rtcp in ((0, False), (4, True), (8, False)):
        put(packets, *(bytes([n]) * 25 for n in range(first, min(first + 4, 10))), rtcp=rtcp)
    assert sorted(data[0] for data in taken(packets)) == [6, 7, 8, 9]
    assert packets.report(0).drops["full"] == 6
    # A full queue that rejects the newest also rejects RTCP.
    packets = queue(DropPolicy.REJECT_NEWEST)
    assert put(packets, 50, 10, rtcp=True) == put(packets, 50, 10) == [True, False]
    assert packets.report(0).drops["full"] == 2


def test_what_exceeds_the_rate_waits_and_unused_octets_take_it_uncharged():
    """8 kbit/s are an octet a millisecond; 20 octets may go at once."""
    packets = queue(DropPolicy.REJECT_NEWEST, rate_bps=8_000, burst_octets=20)
    put(packets, *(bytes([number]) * 10 for number in range(4)))
    sent = {data[0]: ms for ms in range(30) for data in taken(packets, ms * MS)}
    assert sent == {0: 0, 1: 0, 2: 10, 3: 20}
    assert packets.report(30 * MS).delayed == 2
    assert packets.report(30 * MS).max_age_ns == 20 * MS
    packets = queue(DropPolicy.REJECT_NEWEST, rate_bps=8_000, burst_octets=20)
    put(packets, *(bytes([number]) * 20 for number in range(4)))
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


def test_queues_hold_what_the_documents_say():
    limits = {
        level: (one.depth_octets, one.max_age_ns, one.policy, one.rate_bps, one.burst_octets)
        for level, one in DEFAULT_LIMITS.items()
    }
    oldest, newest = DropPolicy.DROP_OLDEST, DropPolicy.REJECT_NEWEST
    assert limits == {
        Level.TMTC: (8_192, 10 * NS_PER_S, newest, 8_000, 512),
        Level.VOICE: (4_096, 100 * NS_PER_MS, oldest, None, None),
        Level.VIDEO: (65_536, 500 * NS_PER_MS, oldest, None, None),
        Level.MAINTENANCE: (65_536, 60 * NS_PER_S, newest, None, None),
    }
