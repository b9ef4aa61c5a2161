"""No sliding window exceeds the cap, whatever is put in and whenever it is polled."""

from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kontur_av.errors import ConfigError
from kontur_av.streams.budget import Pacer

NS_PER_S = 1_000_000_000
MS = 1_000_000


def largest(releases, window_ns):
    """Return the octets in the fullest window of `window_ns`, both ends included, by trying all."""
    return max(
        sum(octets for t, octets in releases if start <= t <= start + window_ns)
        for start, _ in releases
    )


steps = st.lists(
    st.tuples(
        st.integers(0, 120 * MS),
        st.lists(st.integers(1, 600), max_size=6),
        st.booleans(),
    ),
    min_size=1,
    max_size=60,
)


@given(steps, st.sampled_from([85_000, 85_001, 512_000]), st.sampled_from([None, 2_000_000]))
def test_no_window_exceeds_the_cap(script, cap_bps, channel_bps):
    pacer = Pacer(cap_bps=cap_bps, channel_bps=channel_bps, window_ns=NS_PER_S)
    now, serial, put, got, releases = 0, 0, [], [], []
    for step, sizes, exactly in script:
        due = pacer.poll_timeout()
        now = max(now, due) if exactly and due is not None else now + step
        packets = []
        for size in sizes:
            packets.append(serial.to_bytes(4, "big") + bytes(size))
            serial += 1
        put += packets
        pacer.handle_access_unit(packets, sizes, now)
        while (packet := pacer.poll_transmit(now)) is not None:
            got.append(packet)
            releases.append((now, len(packet) - 4))
    while (due := pacer.poll_timeout()) is not None:
        now = max(now, due)
        packet = pacer.poll_transmit(now)
        assert packet is not None, "poll_timeout promised a packet"
        got.append(packet)
        releases.append((now, len(packet) - 4))
    assert got == put
    assert pacer.backlog_octets == pacer.depth == 0
    if releases:
        assert largest(releases, NS_PER_S) * 8 <= cap_bps
        assert largest(releases, 100 * MS) * 80 <= cap_bps * 1.5


@given(steps, st.integers(0, 2**32))
def test_the_cap_holds_for_an_observer_whose_clock_jitters(script, seed):
    pacer, random = Pacer(cap_bps=85_000), Random(seed)
    now, seen = 0, []
    for step, sizes, _ in script:
        now += step
        pacer.handle_access_unit([bytes(size) for size in sizes], sizes, now)
    while (due := pacer.poll_timeout()) is not None:
        now = max(now, due)
        packet = pacer.poll_transmit(now)
        seen.append((now + random.randrange(10 * MS), len(packet)))
    if seen:
        assert largest(seen, NS_PER_S) * 8 <= 85_000


def test_packets_leave_exactly_when_due():
    pacer = Pacer(cap_bps=80_000)
    pacer.handle_access_unit([b"a" * 100, b"b" * 100], [100, 100], 0)
    assert pacer.poll_transmit(0) == b"a" * 100
    assert pacer.poll_transmit(0) is None
    assert pacer.poll_timeout() == 10 * MS
    assert pacer.poll_transmit(10 * MS - 1) is None
    assert pacer.oldest_age_ns(10 * MS - 1) == 10 * MS - 1
    assert pacer.poll_transmit(10 * MS) == b"b" * 100
    assert pacer.poll_timeout() is None
    assert pacer.longest_wait_ns == 10 * MS


def test_packets_after_an_idle_time_are_spaced_as_the_channel_carries_them():
    pacer = Pacer(cap_bps=80_000, channel_bps=100_000)
    now_ns, left = 10 * NS_PER_S, []
    pacer.handle_access_unit([bytes(100)] * 5, [100] * 5, now_ns)
    while (due_ns := pacer.poll_timeout()) is not None:
        now_ns = max(now_ns, due_ns)
        assert pacer.poll_transmit(now_ns) is not None
        left.append(now_ns - 10 * NS_PER_S)
        assert pacer.poll_transmit(now_ns) is None
    # 100 octets take 8 ms of the channel.
    assert left == [0, 8 * MS, 16 * MS, 24 * MS, 32 * MS]
    assert (pacer.released.events, pacer.longest_wait_ns) == (5, 32 * MS)
    assert pacer.released.last_ns == now_ns


def test_the_queue_tells_its_depth_and_its_oldest_age():
    pacer = Pacer(cap_bps=80_000)
    assert pacer.oldest_age_ns(7 * MS) == 0
    pacer.handle_access_unit([bytes(100)] * 2, [100] * 2, 5 * MS)
    pacer.handle_access_unit([bytes(50)], [50], 6 * MS)
    assert (pacer.depth, pacer.backlog_octets) == (3, 250)
    assert pacer.poll_transmit(5 * MS) is not None
    assert (pacer.depth, pacer.backlog_octets) == (2, 150)
    assert pacer.oldest_age_ns(9 * MS) == 4 * MS


def test_room_is_back_exactly_when_the_window_has_passed():
    # 1500 octets in 100 ms: 15 packets of 100, and each is free again 110 ms after it left.
    pacer = Pacer(cap_bps=80_000, channel_bps=80_000_000)
    assert pacer.max_payload_octets == 1500
    pacer.handle_access_unit([bytes(100)] * 16, [100] * 16, 0)
    step_ns = 10_000
    for number in range(15):
        assert pacer.poll_timeout() == number * step_ns
        assert pacer.poll_transmit(number * step_ns) is not None
    assert pacer.poll_timeout() == 110 * MS
    assert pacer.poll_transmit(110 * MS - 1) is None
    assert pacer.poll_transmit(110 * MS) is not None


def test_another_cap_counts_from_now_on():
    pacer = Pacer(cap_bps=80_000, picture_ns=100 * MS)
    assert pacer.picture_octets == 1000
    pacer.follow(cap_bps=160_000, channel_bps=320_000)
    assert (pacer.cap_bps, pacer.channel_bps, pacer.picture_octets) == (160_000, 320_000, 2000)
    # Packets stay small, 1500 octets of payload; two of them take 75 ms of the new channel.
    assert pacer.max_payload_octets == 1500
    pacer.handle_access_unit([bytes(1500)] * 2, [1500] * 2, 0)
    assert pacer.poll_transmit(0) is not None
    assert pacer.poll_timeout() == 37_500_000
    assert pacer.poll_transmit(37_500_000) is not None
    pacer.follow(cap_bps=80_000, channel_bps=80_000)
    for cap_bps, channel_bps in ((79_999, 80_000), (80_001, 80_000)):
        with pytest.raises(ValueError, match="at least 80000"):
            pacer.follow(cap_bps=cap_bps, channel_bps=channel_bps)


def test_the_next_picture_starts_when_the_channel_has_taken_those_before_it():
    pacer = Pacer(cap_bps=80_000, picture_ns=33 * MS)
    assert pacer.start_ns(0) == 0
    pacer.handle_access_unit([bytes(500)] * 2, [500] * 2, 0)
    pacer.poll_transmit(0)
    assert pacer.start_ns(0) == 100 * MS
    pacer.poll_transmit(50 * MS)
    assert pacer.start_ns(66 * MS) == 100 * MS
    assert pacer.start_ns(101 * MS) == 101 * MS


def test_a_full_second_delays_the_next_picture_although_the_channel_is_free():
    pacer = Pacer(cap_bps=80_000, channel_bps=8_000_000, picture_ns=110 * MS)
    assert pacer.picture_octets == 1100
    now = 0
    for _ in range(6):
        pacer.handle_access_unit([bytes(1500)], [1500], now)
        now = pacer.poll_timeout()
        assert pacer.poll_transmit(now) is not None
    assert now == 550 * MS
    assert pacer.start_ns(now + 200 * MS) > now + 200 * MS + 33 * MS
    assert pacer.start_ns(1_000 * MS) <= 1_000 * MS + 33 * MS


def test_a_packet_that_can_never_leave_is_refused_at_once():
    pacer = Pacer(cap_bps=10_000)
    assert pacer.max_payload_octets == 187
    with pytest.raises(ValueError, match="at most 187"):
        pacer.handle_access_unit([bytes(188)], [188], 0)


@pytest.mark.parametrize(
    ("kwargs", "text"),
    [({"cap_bps": 0}, "at least 1000"), ({"cap_bps": 90_000, "channel_bps": 80_000}, "80000")],
)
def test_invalid_budgets_are_refused(kwargs, text):
    with pytest.raises(ConfigError, match=text):
        Pacer(**kwargs)


def test_a_picture_behind_more_than_a_window_holds_starts_when_the_window_is_empty():
    pacer = Pacer(cap_bps=85_000, channel_bps=2_000_000)
    pacer.handle_access_unit([bytes(500)] * 10, [500] * 10, 0)
    while (due_ns := pacer.poll_timeout()) is not None and due_ns < 50 * MS:
        assert pacer.poll_transmit(due_ns) is not None
        last_ns = due_ns
    assert pacer.depth == 7
    # 100 ms, and the guard of 10 ms.
    assert pacer.start_ns(60 * MS) == last_ns + 110 * MS
