"""No sliding window exceeds the cap, whatever is put in and whenever it is polled.

The newest picture is encoded as the channel runs dry, but not when it is too old.
"""

from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kontur_av.errors import ConfigError
from kontur_av.streams.budget import EncodeScheduler, Pacer

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


PERIOD = 1_000_000_000 // 30


def clock_with(octets_at_start=0):
    pacer = Pacer(cap_bps=80_000)
    if octets_at_start:
        pacer.handle_access_unit([bytes(octets_at_start)], [octets_at_start], 0)
        assert pacer.poll_transmit(0)
    return EncodeScheduler(pacer, fps=30)


def test_a_dry_channel_takes_a_picture_at_once():
    clock = clock_with()
    assert not clock.poll_encode(0)
    clock.handle_picture(0, 5 * MS)
    assert clock.poll_timeout() == 5 * MS
    assert clock.poll_encode(5 * MS)
    assert clock.poll_timeout() is None
    assert not clock.poll_encode(6 * MS)


def test_a_picture_is_encoded_when_the_channel_will_be_dry_by_then():
    clock = clock_with(300)  # 30 ms of the channel
    clock.handle_picture(20 * MS, 24 * MS)
    assert not clock.poll_encode(24 * MS)
    due_ns = clock.poll_timeout()
    # The coding time is assumed to be 3 ms until one was measured.
    assert due_ns == 27 * MS
    assert clock.poll_encode(due_ns)


def test_waiting_packets_do_not_delay_the_next_coding():
    pacer = Pacer(cap_bps=80_000)
    clock = EncodeScheduler(pacer, fps=30)
    pacer.handle_access_unit([bytes(270), bytes(20)], [270, 20], 0)  # 27 and 2 ms of the channel
    assert pacer.poll_transmit(0)
    clock.handle_picture(0, 20 * MS)
    due_ns = clock.poll_timeout()
    assert due_ns == 26 * MS < pacer.poll_timeout()
    assert clock.poll_encode(due_ns)


def test_one_picture_is_encoded_at_a_time():
    clock = clock_with()
    clock.handle_picture(0, 0)
    assert clock.poll_encode(0)
    clock.handle_picture(PERIOD, PERIOD)
    assert clock.poll_timeout() is None
    assert not clock.poll_encode(PERIOD)
    clock.handle_encoded(PERIOD + 5 * MS)
    assert clock.poll_encode(PERIOD + 5 * MS)
    assert clock.refused == 0


def test_an_old_picture_is_replaced_but_not_for_ever():
    clock = clock_with(300)
    clock.handle_picture(0, 10 * MS)
    assert not clock.poll_encode(27 * MS)
    clock.handle_picture(PERIOD, 10 * MS + PERIOD)
    assert clock.poll_encode(10 * MS + PERIOD)
    assert (clock.captured, clock.refused) == (2, 1)
    alone = clock_with(300)
    alone.handle_picture(0, 10 * MS)
    due_ns = alone.poll_timeout()
    assert 10 * MS + PERIOD < due_ns < 10 * MS + 2 * PERIOD
    assert alone.poll_encode(due_ns)


def test_nothing_is_encoded_while_the_link_is_behind_its_cap():
    clock = clock_with()
    clock.handle_channel(10_000, 96_000, 0)
    clock.handle_picture(0, 0)
    for now_ns in range(0, 30 * MS, MS):
        assert not clock.poll_encode(now_ns)
        assert clock.poll_timeout() > now_ns
    clock.handle_channel(0, 96_000, 30 * MS)
    clock.handle_picture(31 * MS, 31 * MS)
    assert clock.poll_encode(31 * MS)


def test_the_coding_time_is_measured():
    pacer = Pacer(cap_bps=80_000)
    clock = EncodeScheduler(pacer, fps=30)
    clock.handle_picture(0, 0)
    assert clock.poll_encode(0)
    clock.handle_encoded(11 * MS)
    pacer.handle_access_unit([bytes(300)], [300], 40 * MS)  # 30 ms of the channel
    assert pacer.poll_transmit(40 * MS)
    clock.handle_picture(60 * MS, 65 * MS)
    # 3 ms were assumed; one part in eight of the difference counts.
    assert clock.poll_timeout() == 66 * MS


def test_a_picture_that_is_not_to_be_encoded_cannot_be_encoded():
    clock = clock_with()
    with pytest.raises(ValueError, match="no picture"):
        clock.handle_encoded(0)


def test_pictures_left_out_and_the_last_one_are_refused():
    clock = clock_with()
    clock.handle_picture(0, 0, skipped=2)
    assert (clock.captured, clock.refused) == (3, 2)
    clock.handle_picture(PERIOD, PERIOD)
    assert (clock.captured, clock.refused) == (4, 3)
    clock.finish()
    clock.finish()
    assert clock.refused == 4
    assert clock.poll_timeout() is None


def test_a_picture_may_be_22_parts_of_a_hundred_of_a_period_old():
    for age_ms, waits in ((7, False), (8, True)):
        clock = clock_with(300)
        came_ns = 27 * MS - age_ms * MS
        clock.handle_picture(0, came_ns)
        # An older one waits for the next picture, and an eighth of a period more.
        give_up_ns = came_ns + PERIOD + PERIOD // 8
        assert clock.poll_timeout() == (give_up_ns if waits else 27 * MS)


def test_of_a_faster_camera_only_fresh_pictures_are_encoded():
    pacer = Pacer(cap_bps=80_000)
    clock = EncodeScheduler(pacer, fps=30, camera_hz=60)
    ages_ms = []
    for now_ns in range(0, 3_000 * MS, MS // 4):
        if now_ns % (16 * MS) == 0:
            clock.handle_picture(now_ns, now_ns)
            came_ns = now_ns
        if clock.poll_encode(now_ns):
            ages_ms.append((now_ns - came_ns) / MS)
            clock.handle_encoded(now_ns)
            pacer.handle_access_unit([bytes(300)], [300], now_ns)
        while pacer.poll_transmit(now_ns):
            pass
    assert 85 <= len(ages_ms) <= 94
    # 22 hundredths of the camera's period, and a step of this loop.
    assert max(ages_ms) <= 4
    assert clock.next_rate_hz() is None


def test_a_faster_camera_that_slows_down_is_awaited_for_its_new_period():
    clock = EncodeScheduler(Pacer(cap_bps=80_000), fps=30, camera_hz=60)
    for came_ns in range(0, 50 * 25 * MS, 25 * MS):
        clock.handle_picture(came_ns, came_ns)
    assert clock.next_rate_hz() is None
    # The channel is busy for 13 ms: the picture would be too old.
    clock.handle_channel(13, 8_000, came_ns)
    assert clock.poll_timeout() == came_ns + 25 * MS + 25 * MS // 8


def test_a_channel_that_is_behind_is_looked_at_again_after_2_ms():
    clock = clock_with()
    share = 80_000 // 8 // 30
    for octets, due_ms in ((share, 0), (share + 1, 2)):
        clock.handle_channel(octets, 80_000_000, 0)
        clock.handle_picture(0, 10 * MS)
        assert clock.poll_timeout() == (10 + due_ms) * MS


def test_a_slower_camera_is_told_after_45_pictures_and_a_faster_one_after_15():
    clock, now_ns = EncodeScheduler(Pacer(cap_bps=80_000), fps=60), 0
    clock.handle_picture(0, 0)
    for hz, pictures in ((15, 45), (60, 15)):
        for _ in range(pictures):
            assert clock.next_rate_hz() is None
            now_ns += 1_000_000_000 // hz
            clock.handle_picture(now_ns, now_ns)
        assert clock.next_rate_hz() == pytest.approx(hz, rel=0.01)
        assert clock.next_rate_hz() is None


@pytest.mark.parametrize("hz", [25, 15, 7])
def test_a_regular_camera_that_is_slower_is_followed_and_back_again(hz):
    clock, now_ns, rates = clock_with(), 0, []
    for rate in [hz] * 100 + [30] * 40:
        now_ns += 1_000_000_000 // rate
        clock.handle_picture(now_ns, now_ns)
        rates += [found for found in (clock.next_rate_hz(),) if found is not None]
    assert rates[0] == pytest.approx(hz, rel=0.02)
    assert rates[-1] == pytest.approx(30, rel=0.15)
    assert len(rates) <= 3


def test_single_delays_are_no_new_rate():
    clock, now_ns = clock_with(), 0
    for i in range(300):
        now_ns += PERIOD * (5 if i % 4 == 0 else 1)
        clock.handle_picture(now_ns, now_ns)
        assert clock.next_rate_hz() is None


@given(
    st.lists(st.tuples(st.integers(0, 80 * MS), st.booleans(), st.integers(1, 900)), max_size=80)
)
def test_every_picture_is_encoded_or_refused(script):
    pacer = Pacer(cap_bps=80_000)
    clock, now_ns, encoded = EncodeScheduler(pacer, fps=30), 0, 0
    for step_ns, comes, octets in script:
        now_ns += step_ns
        while pacer.poll_transmit(now_ns) is not None:
            pass
        if comes:
            clock.handle_picture(now_ns, now_ns)
        waits = clock.poll_timeout() is not None
        if clock.poll_encode(now_ns):
            encoded += 1
            waits = False
            pacer.handle_access_unit([bytes(octets)], [octets], now_ns)
            clock.handle_encoded(now_ns)
        assert clock.captured == encoded + clock.refused + waits
