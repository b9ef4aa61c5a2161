"""Bursts follow the chain of Gilbert and Elliott; blackouts overlap and affect both directions."""

from itertools import islice, pairwise
from random import Random

from hypothesis import given, settings
from hypothesis import strategies as st

from telepresence.link.radio.channel import (
    BlackoutClock,
    BurstClock,
    Bursts,
    RandomBlackouts,
    random_windows,
)
from telepresence.link.radio.profile import RadioProfile

MS, S = 1_000_000, 1_000_000_000


def clock(gap_s=0.1, mean_ms=5.0, seed=1):
    return BurstClock(Bursts(gap_s=gap_s, mean_ms=mean_ms, frame_loss=1.0), Random(seed))


def test_stays_are_geometric_with_the_requested_means():
    bursts = clock()
    bad = [bursts.state(slot * MS)[0] for slot in range(400_000)]
    # Step probabilities of the chain, from the states alone.
    leaving = sum(a and not b for a, b in pairwise(bad))
    entering = sum(b and not a for a, b in pairwise(bad))
    in_bad, in_good = sum(bad), len(bad) - sum(bad)
    assert abs(leaving / in_bad - 1 / 5) < 5 * (0.2 * 0.8 / in_bad) ** 0.5
    assert abs(entering / in_good - 1 / 100) < 5 * (0.01 / in_good) ** 0.5
    # Memoryless: after ten bad slots the eleventh is as likely as the second.
    after_ten = [all(bad[k : k + 10]) for k in range(len(bad) - 10)]
    still = sum(bad[k + 10] for k, ten in enumerate(after_ten) if ten)
    assert abs(still / sum(after_ten) - 0.8) < 0.05


def test_a_mean_of_one_slot_is_always_one_slot():
    bursts = clock(mean_ms=1.0)
    bad = [bursts.state(slot * MS)[0] for slot in range(50_000)]
    assert any(bad)
    assert not any(a and b for a, b in pairwise(bad))


def test_states_do_not_depend_on_the_number_of_requests():
    often, seldom = clock(seed=9), clock(seed=9)
    every = [often.state(slot * MS // 4)[0] for slot in range(40_000)]
    assert [seldom.state(slot * MS)[0] for slot in range(0, 10_000, 7)] == every[::28]


@settings(max_examples=100, deadline=None)
@given(
    windows=st.lists(st.tuples(st.integers(0, 400), st.integers(1, 60)), max_size=12),
    times=st.lists(st.integers(0, 500), min_size=1, max_size=60),
)
def test_a_blackout_is_the_union_of_its_windows(windows, times):
    given_windows = [(begin, begin + length) for begin, length in windows]
    blackouts = BlackoutClock(given_windows)
    for time in sorted(times):
        dark, until = blackouts.state(time)
        expected = {t for begin, end in given_windows for t in range(begin, end)}
        assert dark == (time in expected)
        assert until > time
        assert all((t in expected) == dark for t in range(time, min(until, 600)))
        assert blackouts.dark_ns(time) == sum(t < time for t in expected)


def test_random_blackouts_have_their_means_and_hit_both_directions_alike():
    windows = list(
        islice(
            random_windows(Random(2), RandomBlackouts(gap_s=10.0, shortest_s=1.0, longest_s=3.0)),
            3000,
        )
    )
    lengths = [(end - begin) / S for begin, end in windows]
    assert 1.0 <= min(lengths) <= max(lengths) <= 3.0
    assert abs(sum(lengths) / 3000 - 2.0) < 5 * 0.58 / 3000**0.5
    gaps = [(b - a) / S for (_, a), (b, _) in pairwise(windows)]
    assert abs(sum(gaps) / len(gaps) - 10.0) < 5 * 10 / len(gaps) ** 0.5

    profile = RadioProfile(
        name="x", random_blackouts=RandomBlackouts(gap_s=0.5, shortest_s=0.05, longest_s=0.2)
    )
    up = profile.path("uplink", seed=3, epoch_ns=0)
    down = profile.path("downlink", seed=3, epoch_ns=0)
    for slot in range(20_000):
        up.handle_frame(bytes(32), slot * MS)
        lost = down.frames_lost
        if slot % 3 == 0:
            before = up.frames_lost
            down.handle_frame(bytes(500), slot * MS)
            up.handle_frame(bytes(32), slot * MS)
            assert (down.frames_lost > lost) == (up.frames_lost > before)
    assert down.frames_lost > 500
