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
PERIOD = NS_PER_S // 30


def put(pacer, *sizes, at_ns=0):
    pacer.handle_access_unit([bytes(size) for size in sizes], sizes, at_ns)


def release(pacer, now_ns=0, until_ns=10**18):
    """Take what leaves at each timeout; return (instant, packet) of each."""
    released = []
    while (due_ns := pacer.poll_timeout()) is not None and due_ns < until_ns:
        now_ns = max(now_ns, due_ns)
        packet = pacer.poll_transmit(now_ns)
        assert packet is not None, "poll_timeout promised a packet"
        released.append((now_ns, packet))
    return released


def largest(releases, window_ns):
    """Return the octets in the fullest window of `window_ns`, both ends included, by trying all."""
    return max(
        sum(octets for t, octets in releases if start <= t <= start + window_ns)
        for start, _ in releases
    )


steps = st.lists(
    st.tuples(st.integers(0, 120 * MS), st.lists(st.integers(1, 600), max_size=6), st.booleans()),
    min_size=1,
    max_size=60,
)


@given(steps, st.sampled_from([85_000, 85_001, 512_000]), st.sampled_from([None, 2_000_000]))
def test_no_window_exceeds_the_cap(script, cap_bps, channel_bps):
    pacer = Pacer(cap_bps=cap_bps, channel_bps=channel_bps, window_ns=NS_PER_S)
    now, given, got = 0, [], []
    for step, sizes, exactly in script:
        due = pacer.poll_timeout()
        now = max(now, due) if exactly and due is not None else now + step
        first = len(given)
        packets = [(first + n).to_bytes(4, "big") + bytes(size) for n, size in enumerate(sizes)]
        given += packets
        pacer.handle_access_unit(packets, sizes, now)
        while (packet := pacer.poll_transmit(now)) is not None:
            got.append((now, packet))
    got += release(pacer, now)
    assert [packet for _, packet in got] == given
    assert pacer.backlog_octets == pacer.depth == 0
    if got:
        releases = [(at_ns, len(packet) - 4) for at_ns, packet in got]
        assert largest(releases, NS_PER_S) * 8 <= cap_bps
        assert largest(releases, 100 * MS) * 80 <= cap_bps * 1.5


@given(steps, st.integers(0, 2**32))
def test_the_cap_holds_for_an_observer_whose_clock_jitters(script, seed):
    pacer, random, now = Pacer(cap_bps=85_000), Random(seed), 0
    for step, sizes, _ in script:
        now += step
        put(pacer, *sizes, at_ns=now)
    seen = [(at + random.randrange(10 * MS), len(packet)) for at, packet in release(pacer, now)]
    if seen:
        assert largest(seen, NS_PER_S) * 8 <= 85_000


@pytest.mark.rule("4")
def test_packets_leave_exactly_when_due_and_the_queue_tells_its_depth_and_oldest_age():
    pacer = Pacer(cap_bps=80_000)
    assert pacer.oldest_age_ns(7 * MS) == 0
    pacer.handle_access_unit([b"a" * 100, b"b" * 100], [100, 100], 0)
    assert pacer.poll_transmit(0) == b"a" * 100
    assert pacer.poll_transmit(0) is None
    put(pacer, 50, at_ns=6 * MS)
    assert (pacer.depth, pacer.backlog_octets) == (2, 150)
    assert pacer.poll_timeout() == 10 * MS
    assert pacer.poll_transmit(10 * MS - 1) is None
    assert pacer.oldest_age_ns(10 * MS - 1) == 10 * MS - 1
    assert pacer.poll_transmit(10 * MS) == b"b" * 100
    assert pacer.longest_wait_ns == 10 * MS
    assert pacer.oldest_age_ns(11 * MS) == 5 * MS
    # After an idle time they are spaced as the channel carries them: 100 octets take 8 ms.
    pacer, idle_ns = Pacer(cap_bps=80_000, channel_bps=100_000), 10 * NS_PER_S
    put(pacer, *[100] * 5, at_ns=idle_ns)
    left = [at_ns - idle_ns for at_ns, _ in release(pacer, idle_ns)]
    assert left == [0, 8 * MS, 16 * MS, 24 * MS, 32 * MS]
    assert (pacer.released.events, pacer.longest_wait_ns) == (5, 32 * MS)
    assert pacer.released.last_ns == idle_ns + left[-1]


def test_room_is_back_exactly_when_the_window_has_passed():
    # 1500 octets in 100 ms: 15 packets of 100, and each is free again 110 ms after it left.
    pacer = Pacer(cap_bps=80_000, channel_bps=80_000_000)
    assert pacer.max_payload_octets == 1500
    put(pacer, *[100] * 16)
    left = release(pacer, until_ns=100 * MS)
    assert [at_ns for at_ns, _ in left] == [number * 10_000 for number in range(15)]
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
    put(pacer, 1500, 1500)
    left = release(pacer)
    assert [at_ns for at_ns, _ in left] == [0, 37_500_000]
    # A lower cap holds from now on, over what has left under the higher one, too.
    pacer.follow(cap_bps=40_000, channel_bps=80_000)
    assert (pacer.max_payload_octets, pacer.picture_octets) == (750, 500)
    put(pacer, *[500] * 20, at_ns=38 * MS)
    slower = release(pacer, 38 * MS)
    assert slower[0][0] == 37_500_000 + 110 * MS
    left = [(at_ns, len(packet)) for at_ns, packet in left + slower]
    assert largest(left, 1000 * MS) <= 5000 and largest(left[2:], 100 * MS) <= 750
    with pytest.raises(ValueError, match="at most 750"):
        put(pacer, 751)
    for cap_bps, channel_bps in ((999, 80_000), (80_001, 80_000)):
        with pytest.raises(ValueError, match="at least 1000"):
            pacer.follow(cap_bps=cap_bps, channel_bps=channel_bps)


def test_the_next_picture_starts_when_channel_and_window_have_room():
    pacer = Pacer(cap_bps=80_000, picture_ns=33 * MS)
    assert pacer.start_ns(0) == 0
    put(pacer, 500, 500)
    pacer.poll_transmit(0)
    assert pacer.start_ns(0) == 100 * MS
    pacer.poll_transmit(50 * MS)
    assert [pacer.start_ns(at * MS) for at in (66, 101)] == [100 * MS, 101 * MS]
    # A full second delays it although the channel is free.
    pacer = Pacer(cap_bps=80_000, channel_bps=8_000_000, picture_ns=110 * MS)
    now = 0
    for _ in range(6):
        put(pacer, 1500, at_ns=now)
        ((now, _),) = release(pacer)
    assert (now, pacer.picture_octets) == (550 * MS, 1100)
    assert pacer.start_ns(now + 200 * MS) > now + 233 * MS
    assert pacer.start_ns(1_000 * MS) <= 1_033 * MS
    # Behind more than a window holds it starts 100 ms, and the guard of 10 ms, after the last.
    pacer = Pacer(cap_bps=85_000, channel_bps=2_000_000)
    put(pacer, *[500] * 10)
    last_ns, _ = release(pacer, until_ns=50 * MS)[-1]
    assert pacer.depth == 7
    assert pacer.start_ns(60 * MS) == last_ns + 110 * MS


def test_what_can_never_leave_is_refused_at_once():
    pacer = Pacer(cap_bps=10_000)
    assert pacer.max_payload_octets == 187
    with pytest.raises(ValueError, match="at most 187"):
        put(pacer, 188)
    with pytest.raises(ConfigError, match="cap_bps 0: take 1000"):
        Pacer(cap_bps=0)
    with pytest.raises(ConfigError, match="80000"):
        Pacer(cap_bps=90_000, channel_bps=80_000)


def scheduler(busy_octets=0, *, fps=30, **options):
    """Return a scheduler and its pacer, of whose channel some octets are just taken."""
    pacer = Pacer(cap_bps=80_000)
    if busy_octets:
        put(pacer, busy_octets)
        assert pacer.poll_transmit(0)
    return EncodeScheduler(pacer, fps=fps, **options), pacer


def test_a_dry_channel_takes_one_picture_at_a_time():
    clock, _ = scheduler()
    assert not clock.poll_encode(0)
    with pytest.raises(ValueError, match="no picture"):
        clock.handle_encoded(0)
    clock.handle_picture(0, 5 * MS)
    assert clock.poll_timeout() == 5 * MS
    assert clock.poll_encode(5 * MS)
    assert clock.poll_timeout() is None and not clock.poll_encode(6 * MS)
    clock.handle_picture(PERIOD, PERIOD)
    assert clock.poll_timeout() is None and not clock.poll_encode(PERIOD)
    clock.handle_encoded(PERIOD + 5 * MS)
    assert clock.poll_encode(PERIOD + 5 * MS)
    assert clock.refused == 0


def test_a_picture_is_encoded_when_the_channel_will_be_dry_by_then():
    clock, _ = scheduler(300)  # 30 ms of the channel
    clock.handle_picture(20 * MS, 24 * MS)
    assert not clock.poll_encode(24 * MS)
    # The coding time is assumed to be 3 ms until one was measured.
    assert clock.poll_timeout() == 27 * MS
    assert clock.poll_encode(27 * MS)
    # Waiting packets do not delay it.
    clock, pacer = scheduler()
    put(pacer, 270, 20)  # 27 and 2 ms of the channel
    assert pacer.poll_transmit(0)
    clock.handle_picture(0, 20 * MS)
    assert clock.poll_timeout() == 26 * MS < pacer.poll_timeout()
    assert clock.poll_encode(26 * MS)
    # Of a measured coding time one part in eight counts.
    clock, pacer = scheduler()
    clock.handle_picture(0, 0)
    assert clock.poll_encode(0)
    clock.handle_encoded(11 * MS)
    put(pacer, 300, at_ns=40 * MS)  # 30 ms of the channel
    assert pacer.poll_transmit(40 * MS)
    clock.handle_picture(60 * MS, 65 * MS)
    assert clock.poll_timeout() == 66 * MS


@pytest.mark.rule("4")
@pytest.mark.parametrize(("age_ms", "waits"), [(7, False), (8, True)])
def test_a_picture_may_be_22_parts_of_a_hundred_of_a_period_old(age_ms, waits):
    clock, _ = scheduler(300)
    came_ns = 27 * MS - age_ms * MS
    clock.handle_picture(0, came_ns)
    # An older one waits for the next picture, and an eighth of a period more.
    due_ns = came_ns + PERIOD + PERIOD // 8 if waits else 27 * MS
    assert clock.poll_timeout() == due_ns
    assert clock.poll_encode(due_ns)


def test_a_channel_that_is_behind_is_looked_at_again_after_2_ms():
    clock, _ = scheduler()
    share = 80_000 // 8 // 30
    for octets, due_ms in ((share, 0), (share + 1, 2)):
        clock.handle_channel(octets, 80_000_000, 0)
        clock.handle_picture(0, 10 * MS)
        assert clock.poll_timeout() == (10 + due_ms) * MS
    # Nothing is encoded while the link is behind its cap.
    clock.handle_channel(10_000, 96_000, 0)
    clock.handle_picture(0, 0)
    for now_ns in range(0, 30 * MS, MS):
        assert not clock.poll_encode(now_ns)
        assert clock.poll_timeout() > now_ns
    clock.handle_channel(0, 96_000, 30 * MS)
    clock.handle_picture(31 * MS, 31 * MS)
    assert clock.poll_encode(31 * MS)


def test_pictures_that_are_replaced_left_out_or_left_over_are_refused():
    clock, _ = scheduler(300)
    clock.handle_picture(0, 10 * MS)
    assert not clock.poll_encode(27 * MS)
    clock.handle_picture(PERIOD, 10 * MS + PERIOD)
    assert clock.poll_encode(10 * MS + PERIOD)
    assert (clock.captured, clock.refused) == (2, 1)
    clock, _ = scheduler()
    clock.handle_picture(0, 0, skipped=2)
    assert (clock.captured, clock.refused) == (3, 2)
    clock.handle_picture(PERIOD, PERIOD)
    assert (clock.captured, clock.refused) == (4, 3)
    clock.finish()
    clock.finish()
    assert clock.refused == 4
    assert clock.poll_timeout() is None


def test_of_a_faster_camera_only_fresh_pictures_are_encoded():
    clock, pacer = scheduler(camera_hz=60)
    ages_ms = []
    for now_ns in range(0, 3_000 * MS, MS // 4):
        if now_ns % (16 * MS) == 0:
            clock.handle_picture(now_ns, now_ns)
            came_ns = now_ns
        if clock.poll_encode(now_ns):
            ages_ms.append((now_ns - came_ns) / MS)
            clock.handle_encoded(now_ns)
            put(pacer, 300, at_ns=now_ns)
        while pacer.poll_transmit(now_ns):
            pass
    assert 85 <= len(ages_ms) <= 94
    # 22 hundredths of the camera's period, and a step of this loop.
    assert max(ages_ms) <= 4
    assert clock.next_rate_hz() is None


def test_a_faster_camera_that_slows_down_is_awaited_for_its_new_period():
    clock, _ = scheduler(camera_hz=60)
    for came_ns in range(0, 50 * 25 * MS, 25 * MS):
        clock.handle_picture(came_ns, came_ns)
    assert clock.next_rate_hz() is None
    # The channel is busy for 13 ms: the picture would be too old.
    clock.handle_channel(13, 8_000, came_ns)
    assert clock.poll_timeout() == came_ns + 25 * MS + 25 * MS // 8


def rates(clock, *periods_ns):
    """Return the rates that are told, by the number of the picture."""
    now_ns, found = 0, {}
    for number, period_ns in enumerate(periods_ns):
        now_ns += period_ns
        clock.handle_picture(now_ns, now_ns)
        if (hz := clock.next_rate_hz()) is not None:
            found[number] = float(hz)
    return found


@pytest.mark.parametrize("hz", [25, 15, 7])
def test_a_slower_camera_is_followed_after_45_pictures_and_a_faster_one_after_15(hz):
    clock, _ = scheduler(fps=60)
    periods = [NS_PER_S // hz] * 46 + [NS_PER_S // 60] * 15
    assert rates(clock, *periods) == pytest.approx({45: hz, 60: 60}, rel=0.01)
    # A slow camera at a usual rate, and back again.
    clock, _ = scheduler()
    first, *_, last = found = [*rates(clock, *[NS_PER_S // hz] * 100, *[PERIOD] * 40).values()]
    assert (first, last) == (pytest.approx(hz, rel=0.02), pytest.approx(30, rel=0.15))
    assert len(found) <= 3


def test_single_delays_are_no_new_rate():
    assert rates(scheduler()[0], *[5 * PERIOD, PERIOD, PERIOD, PERIOD] * 75) == {}


@given(
    st.lists(st.tuples(st.integers(0, 80 * MS), st.booleans(), st.integers(1, 900)), max_size=80)
)
def test_every_picture_is_encoded_or_refused(script):
    clock, pacer = scheduler()
    now_ns, encoded = 0, 0
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
            put(pacer, octets, at_ns=now_ns)
            clock.handle_encoded(now_ns)
        assert clock.captured == encoded + clock.refused + waits
