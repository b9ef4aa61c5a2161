"""The interval of RTCP on virtual time, against the bounds of RFC 3550 sections 6.2 and 6.3."""

from itertools import pairwise

import pytest

from kontur_av.clock import NS_PER_S
from kontur_av.rtp.report_timer import (
    AVP_LEAST_NS,
    AVPF_LEAST_NS,
    ReportTimer,
    report_interval_ns,
)

#: The divisor of RFC 3550 section 6.3.1, and its bounds of the random factor.
SHORTEST, LONGEST = 0.5 / 1.21828, 1.5 / 1.21828


def reports(timer, number, octets=72):
    """The instants of reports in seconds."""
    timer.begin(0)
    sent = []
    while len(sent) < number:
        now_ns = timer.poll_timeout()
        assert not timer.is_due(now_ns - 1)
        if timer.is_due(now_ns):
            timer.handle_sent(octets, now_ns)
            sent.append(now_ns / NS_PER_S)
    return sent


@pytest.mark.parametrize("seed", [1, 2, 0xFFFF_FFFF])
def test_intervals_are_random_within_the_bounds_and_right_in_the_mean(seed):
    timer = ReportTimer(least_ns=5 * NS_PER_S, bandwidth_bps=None, seed=seed)
    sent = reports(timer, 2000)
    pauses = [after - before for before, after in pairwise(sent)]
    assert 5 * SHORTEST <= min(pauses) < 5 * 0.6 and 5 * 1.2 < max(pauses) <= 5 * LONGEST
    assert sum(pauses) / len(pauses) == pytest.approx(5, rel=0.03)
    assert len({round(pause, 6) for pause in pauses}) > 1900


def test_each_seed_has_intervals_of_its_own_and_the_same_again():
    first, again, other = (
        reports(ReportTimer(least_ns=NS_PER_S, bandwidth_bps=None, seed=seed), 20)
        for seed in (7, 7, 8)
    )
    assert first == again != other


def test_reports_of_both_ends_take_a_twentieth_of_a_thin_session():
    timer = ReportTimer(least_ns=AVPF_LEAST_NS, bandwidth_bps=8000, seed=3)
    sent = reports(timer, 2000)
    # Two members send 100 octets each, with the headers of IP and UDP, of 50 octets a second.
    assert sent[-1] / 2000 == pytest.approx(4, rel=0.03)


def test_the_first_report_is_due_at_once_and_silence_makes_none():
    timer = ReportTimer(least_ns=NS_PER_S, bandwidth_bps=None, seed=1)
    assert timer.poll_timeout() is None and not timer.is_due(10**12)
    assert reports(timer, 2)[0] == 0
    due_ns = timer.poll_timeout()
    timer.begin(5)
    assert timer.poll_timeout() == due_ns


def test_reports_are_frequent_only_where_the_profile_has_feedback():
    assert report_interval_ns(frequent=True) == AVPF_LEAST_NS == NS_PER_S
    assert report_interval_ns(frequent=False) == AVP_LEAST_NS == 5 * NS_PER_S


def test_the_size_of_reports_counts_by_a_sixteenth_beside_that_of_probable_ones():
    """RFC 3550 sections 6.3.2 and 6.3.3: the mean begins with 72 octets, and 28 of IP and UDP."""
    waits_s = []
    for seed in range(400):
        timer = ReportTimer(least_ns=1, bandwidth_bps=8000, seed=seed)
        timer.begin(0)
        timer.handle_sent(872, 0)
        waits_s.append(timer.poll_timeout() / NS_PER_S)
    # Two members of 150 octets, of 50 a second; e - 1.5 makes up for reconsideration.
    assert sum(waits_s) / len(waits_s) == pytest.approx(6 / 1.21828, rel=0.03)
    assert 3 / 1.21828 <= min(waits_s) < 3.1 / 1.21828 and max(waits_s) > 8.9 / 1.21828
