"""A pass that took place: its windows, its fading, and eleven minutes of it on virtual time."""

import itertools
from dataclasses import replace
from itertools import pairwise

import pytest

from telepresence.link.radio import load_radio
from telepresence.link.radio.contact import Contact, ContactFading, FadingCurve

MS = 1_000_000
#: Shorter ones are bursts of errors; from this length on a link notices a loss of signal.
DROP_OUT = 50


def test_the_stored_pass_is_the_one_of_18_august_2015():
    # DLR told the press: at 16:37 CEST (14:37 UTC) the robot's finger moved for the first time.
    windows = ContactFading(Contact(), seed=1).windows()
    assert windows.acquisition.startswith("2015-08-18T14:32")
    assert 14 * 60 + 37 <= 14 * 60 + 32 + (28 + windows.peak_s) / 60 < 14 * 60 + 38
    assert 400 < windows.nearest_km < 450
    assert 60 < windows.peak_deg <= 90


def test_fading_has_mean_0_and_variance_1_at_knots_and_between():
    for rest in (0, 350, 500):
        values = [FadingCurve(seed, 1000).at(5000 + rest) for seed in range(2000)]
        mean = sum(values) / len(values)
        variance = sum(value * value for value in values) / len(values)
        assert abs(mean) < 5 / len(values) ** 0.5
        assert abs(variance - 1) < 5 * (2 / len(values)) ** 0.5


def test_fading_is_continuous_and_the_same_in_any_order():
    curve, again = FadingCurve(1, 1000), FadingCurve(1, 1000)
    values = [curve.at(time) for time in range(0, 20_000, 10)]
    steps = [abs(b - a) for a, b in itertools.pairwise(values)]
    assert max(steps) < 0.1
    assert [again.at(time) for time in (19_990, 0, 7770)] == [values[-1], values[0], values[777]]


def test_both_ends_see_the_same_fading_at_different_instants():
    here, there = ContactFading(Contact(), seed=6), ContactFading(Contact(), seed=6)
    rates = set()
    for step_ns in range(0, 60_000_000_000, 30_000_000):
        one, other = here.state(step_ns + 300_000), there.state(step_ns + 9_700_000)
        assert (one.signal, one.bit_error_rate) == (other.signal, other.bit_error_rate)
        rates.add(one.bit_error_rate)
    assert len(rates) > 100


class Watched:
    """A frame every millisecond through eleven minutes of the pass."""

    def __init__(self, seed):
        path = load_radio("iss-pass").path("uplink", seed=seed, epoch_ns=0)
        self.good, self.delays = [], []
        for slot in range(660_000):
            spoiled = path.frames_lost + path.frames_hit
            path.handle_frame(bytes(32), slot * MS)
            path.poll_transmit(slot * MS)
            if path.frames_lost + path.frames_hit == spoiled:
                self.good.append(slot)
            if slot % 1000 == 0:
                self.delays.append(path.delay_ns)
        self.report = path.report()
        self.drop_outs = [(a, b) for a, b in pairwise(self.good) if b - a > DROP_OUT]
        middle = self.good[len(self.good) // 2]
        self.usable_from = max(b for _, b in self.drop_outs if b < middle)
        self.usable_to = min(a for a, _ in self.drop_outs if a > middle)


@pytest.fixture(scope="module")
def watched():
    return Watched(seed=1)


def test_eight_minutes_are_usable_between_two_times_about_a_minute_of_drop_outs(watched):
    seen, first, last = watched, watched.good[0], watched.good[-1]
    assert last - first <= 600_000
    assert seen.usable_to - seen.usable_from >= 480_000
    for length in (seen.usable_from, last - seen.usable_to):
        assert 30_000 <= length <= 75_000
    begin = [gap for gap in seen.drop_outs if gap[1] <= seen.usable_from]
    end = [gap for gap in seen.drop_outs if gap[0] >= seen.usable_to]
    assert len(begin) >= 5
    assert len(end) >= 5
    usable = [slot for slot in seen.good if seen.usable_from <= slot <= seen.usable_to]
    assert 1 - len(usable) / (seen.usable_to - seen.usable_from + 1) < 0.01


def test_the_windows_match_the_orbits_prediction(watched):
    windows = watched.report.channel.contact
    assert windows.usable_to_s - windows.usable_from_s >= 480
    assert windows.loss_s <= 600
    assert 1000 * windows.usable_from_s >= watched.usable_from
    assert 1000 * windows.usable_to_s <= watched.usable_to
    assert watched.good[-1] < 1000 * windows.loss_s
    assert watched.report.no_signal_ns > 60_000 * MS


def test_the_delay_falls_to_the_culmination_and_rises_from_there(watched):
    peak = round(watched.report.channel.contact.peak_s)
    before, after = watched.delays[:peak], watched.delays[peak + 1 : 592]
    assert all(a > b for a, b in pairwise(before))
    assert all(a < b for a, b in pairwise(after))
    # Round trip 20 to 31 ms; Kontur-2 measured about 20 to 30.
    assert 19.5e6 < 2 * watched.report.delay_min_ns < 20.5e6
    assert 30e6 < 2 * watched.report.delay_max_ns < 32e6
    light_ns = watched.report.channel.contact.nearest_km / 299792.458 * 1e9
    assert abs(watched.report.delay_min_ns - 8.5e6 - light_ns) < 1000


@pytest.mark.parametrize("start_s", [-5.0, 592.6])
def test_nothing_arrives_before_and_after_the_pass(start_s):
    profile = replace(load_radio("iss-pass"), start_s=start_s)
    path = profile.path("uplink", seed=1, epoch_ns=0)
    for slot in range(5000):
        path.handle_frame(bytes(32), slot * MS)
    assert path.frames_lost == 5000
    assert path.report().no_signal_ns == 4999 * MS
