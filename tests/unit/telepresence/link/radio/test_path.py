"""The radio path: delay, order, flipped bits, and their statistics."""

import itertools
from collections import Counter
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from telepresence.link.radio import (
    Blackout,
    Bursts,
    RadioPath,
    RadioProfile,
    RandomBlackouts,
    load_radio,
)

MS, S = 1_000_000, 1_000_000_000


def through(path, frames, *, step_ns=MS):
    """Return what arrives of frames sent once a step, as (index, frame), in order."""
    arrived = []
    for index, frame in enumerate(frames):
        before = path.frames_lost
        path.handle_frame(frame, index * step_ns)
        if path.frames_lost == before:
            arrived.append(index)
    out = []
    while (due_ns := path.poll_timeout()) is not None:
        out.append(path.poll_transmit(due_ns))
    assert len(out) == len(arrived)
    return list(zip(arrived, out, strict=True))


def flipped(one, other):
    return [
        8 * octet + bit
        for octet, (a, b) in enumerate(zip(one, other, strict=True))
        for bit in range(8)
        if (a ^ b) & (0x80 >> bit)
    ]


@pytest.mark.parametrize("probability", [0.0, 0.03, 0.5, 1.0])
def test_frames_are_lost_at_the_requested_rate(probability):
    path = RadioPath(loss=probability, seed=3)
    number = 20_000
    arrived = through(path, [bytes(32)] * number)
    # Five standard deviations of a binomial distribution.
    deviation = 5 * (number * probability * (1 - probability)) ** 0.5
    assert abs(path.frames_lost - number * probability) <= deviation
    assert len(arrived) == number - path.frames_lost


@pytest.mark.parametrize(
    ("rate", "octets", "loss"),
    [(1e-4, 250, 0.0), (1e-2, 250, 0.2), (0.5, 250, 0.0), (0.02, 1, 0.0)],
)
def test_bits_flip_at_the_requested_rate_and_everywhere(rate, octets, loss):
    """Frames of one octet end often: what is left of a gap between errors goes on in the next."""
    profile = RadioProfile(name="noisy", bit_error_rate=rate, frame_loss=loss)
    path = profile.path("downlink", seed=1, epoch_ns=0)
    number = 1500 if rate < 1e-3 else 200 * 250 // octets
    frame, places, hit = bytes(range(octets)), Counter(), 0
    for _, got in through(path, [frame] * number):
        wrong = flipped(frame, got)
        places.update(wrong)
        hit += bool(wrong)
    assert abs(path.frames_lost - number * loss) <= 5 * (number * loss) ** 0.5
    expected = (number - path.frames_lost) * octets * 8 * rate
    assert abs(places.total() - expected) <= 5 * expected**0.5
    assert (path.bits_flipped, path.frames_hit) == (places.total(), hit)
    # Each half of a frame, and each place within an octet.
    halves = sum(count for place, count in places.items() if place < octets * 4)
    assert abs(halves - places.total() / 2) <= 5 * places.total() ** 0.5
    for bit in range(8):
        share = sum(count for place, count in places.items() if place % 8 == bit)
        assert abs(share - places.total() / 8) <= 5 * (places.total() / 8) ** 0.5
    if rate == 0.5:
        assert {0, 1999} <= set(places)


EVERYTHING = RadioProfile(
    name="all",
    delay_ms=30.0,
    delay_swing_ms=20.0,
    delay_period_s=2.0,
    frame_loss=0.01,
    bit_error_rate=1e-4,
    bursts=Bursts(gap_s=0.2, mean_ms=10, frame_loss=0.5, bit_error_rate=0.01),
    blackouts=(Blackout(start_s=0.3, seconds=0.2),),
    random_blackouts=RandomBlackouts(gap_s=0.5, shortest_s=0.01, longest_s=0.1),
)


def test_same_seed_same_frames_and_each_direction_its_own():
    frames = [bytes([index % 256]) * 32 for index in range(3000)]

    def run(direction, seed):
        return through(EVERYTHING.path(direction, seed=seed, epoch_ns=0), frames)

    assert run("uplink", 1) == run("uplink", 1)
    assert run("uplink", 1) != run("uplink", 2)
    assert run("uplink", 1) != run("downlink", 1)


def test_the_epoch_shifts_all_of_it():
    here = EVERYTHING.path("uplink", seed=1, epoch_ns=0)
    there = EVERYTHING.path("uplink", seed=1, epoch_ns=77 * S + 13)
    for index in range(3000):
        here.handle_frame(bytes(32), index * MS)
        there.handle_frame(bytes(32), index * MS + 77 * S + 13)
        assert here.frames_lost == there.frames_lost
        assert here.frames_hit == there.frames_hit
    assert there.poll_timeout() == here.poll_timeout() + 77 * S + 13


@settings(max_examples=60, deadline=None)
@given(
    steps=st.lists(st.integers(0, 3 * MS), min_size=1, max_size=300),
    radio=st.sampled_from(["cable", "clean", "geo", "iss-pass", "all"]),
    seed=st.integers(0, 2**32),
)
def test_frames_keep_their_order_and_every_lost_one_is_counted(steps, radio, seed):
    profile = EVERYTHING if radio == "all" else load_radio(radio)
    path = profile.path("uplink", seed=seed, epoch_ns=0)
    now_ns, last_ns, arrived = 0, -1, 0
    for number, step in enumerate(steps):
        now_ns += step
        path.handle_frame(number.to_bytes(4, "big") * 8, now_ns)
        path.poll_transmit(-1)
    while (due_ns := path.poll_timeout()) is not None:
        assert due_ns >= last_ns
        assert path.poll_transmit(due_ns - 1) is None
        frame = path.poll_transmit(due_ns)
        assert frame is not None
        assert len(frame) == 32
        last_ns, arrived = due_ns, arrived + 1
    assert arrived + path.frames_lost == path.frames_sent == len(steps)


def test_the_delay_swings_between_its_limits_as_is_told_before_a_frame_is_sent():
    profile = RadioProfile(name="mine", delay_ms=30.0, delay_swing_ms=20.0, delay_period_s=2.0)
    path = profile.path("uplink", seed=1, epoch_ns=0)
    # A report before the first frame is no measurement.
    assert path.report().frames_sent == 0
    delays = []
    for now_ns in range(0, 4 * S, MS):
        path.handle_frame(b"frame", now_ns)
        delays.append(path.delay_ns)
    assert delays[0] == pytest.approx(30 * MS, abs=1)
    # A sine: its ends after a quarter and three quarters of the period.
    assert max(delays) == pytest.approx(50 * MS, abs=0.1 * MS)
    assert min(delays) == pytest.approx(10 * MS, abs=0.1 * MS)
    # 20 ms · 2π / 2 s is 63 µs a millisecond; a step would be more.
    assert max(abs(b - a) for a, b in itertools.pairwise(delays)) < 65_000
    report = path.report()
    assert abs(report.delay_min_ns - min(delays)) < 65_000
    assert abs(report.delay_max_ns - max(delays)) < 65_000
    assert report.delay_max_ns <= profile.longest_delay_ns
    # What is told is when it comes; no frame overtakes one before it.
    path = profile.path("downlink", seed=1, epoch_ns=7)
    for now_ns in range(7, 4 * S, 25 * MS):
        due_ns = path.arrival_ns(now_ns)
        path.handle_frame(b"frame", now_ns)
        assert path.poll_transmit(due_ns - 1) is None and path.poll_transmit(due_ns) == b"frame"


def test_a_blackout_drops_its_frames_and_is_counted():
    profile = RadioProfile(
        name="dark",
        blackouts=(
            Blackout(start_s=2.0, seconds=1.0, direction="downlink"),
            Blackout(start_s=1.0, seconds=0.1),
        ),
    )
    got = {}
    for direction in ("uplink", "downlink"):
        path = profile.path(direction, seed=1, epoch_ns=0)
        got[direction] = [index for index, _ in through(path, [bytes(32)] * 5000)]
        report = path.report()
        assert report.frames_lost * MS == report.channel.blackout_ns
    assert got["uplink"] == [*range(1000), *range(1100, 5000)]
    assert got["downlink"] == [*range(1000), *range(1100, 2000), *range(3000, 5000)]


@pytest.mark.parametrize("name", ["plain", "iss-pass"])
def test_an_outage_loses_every_frame_until_its_end_and_can_be_ended_before(name):
    path = RadioPath(delay_ns=10 * MS)
    if name != "plain":
        profile = replace(load_radio(name), start_s=250.0)
        path = profile.path("uplink", seed=1, epoch_ns=0)
    lost = []
    for slot in range(1000):
        if slot == 100:
            path.handle_outage(300 * MS, slot * MS)
        if slot in (500, 600):
            # Ended before its time.
            path.handle_outage({500: 900 * MS, 600: 0}[slot], slot * MS)
        before = path.frames_lost
        path.handle_frame(bytes(32), slot * MS)
        if path.frames_lost > before:
            lost.append(slot)
    assert lost == [*range(100, 300), *range(500, 600)]
    # What was under way arrives all the same.
    arrived = sum(path.poll_transmit(10 * S) is not None for _ in range(1000))
    assert arrived == 700
