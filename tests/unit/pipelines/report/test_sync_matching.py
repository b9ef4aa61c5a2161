"""Findings are assigned to contacts, and figures are computed from them."""

import pickle
import random
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from told import series

from kontur_av.clock import NS_PER_MS, NS_PER_S
from pipelines.report import sync_metrics
from pipelines.report.sync_matching import LEAST_VERDICT, Matched, judge, match, median_interval
from pipelines.session.session_metrics import ClickRow, ContactRow, LightRow, StepRow
from pipelines.session.setup.setup_file import BUILT_IN

MS = NS_PER_MS


def at(ms, strength=1.0):
    return Matched(round(ms * MS), strength)


@given(
    gaps=st.lists(st.integers(1600, 4000), min_size=1, max_size=20),
    delay=st.integers(1, 600),
    missing=st.sets(st.integers(0, 19)),
)
def test_each_contact_gets_its_own(gaps, delay, missing):
    contacts = [sum(gaps[: index + 1]) * MS for index in range(len(gaps))]
    found = [
        Matched(contact + delay * MS)
        for index, contact in enumerate(contacts)
        if index not in missing
    ]
    matched = match(contacts, found)
    for index, (contact, one) in enumerate(zip(contacts, matched, strict=True)):
        assert (one is None) == (index in missing)
        assert one is None or one.instant_ns == contact + delay * MS
    used = [one for one in matched if one is not None]
    assert len(used) == len(set(used))


def test_the_usual_delay_decides_and_weak_distant_or_early_findings_are_ignored():
    contacts = [second * 2 * NS_PER_S for second in range(10)]
    found = [at(second * 2000 + 80, 1.0) for second in range(10)]
    # Stronger findings, at another time after each contact.
    found += [at(second * 2000 + 300 + 97 * second, 1.5) for second in range(10)]
    found.sort(key=lambda one: one.instant_ns)
    assert [one.instant_ns % (2 * NS_PER_S) for one in match(contacts, found)] == [80 * MS] * 10
    contacts = [second * 2 * NS_PER_S for second in range(8)]
    found = [at(second * 2000 + 80, 10.0) for second in range(8) if second != 4]
    found += [at(4 * 2000 + 900, 3.0)]
    assert match(contacts, sorted(found, key=lambda one: one.instant_ns))[4] is None
    assert match([0], [at(200)], soonest_ns=250 * MS) == [None]
    assert match([0], [at(200), at(320)], soonest_ns=250 * MS) == [at(320)]
    assert match([], [at(1)]) == []
    assert match([0, NS_PER_S], []) == [None, None]


def metrics(stamp_off_ms=0.0, contacts=10, slack_ms=33):
    """Contacts 2.03 s apart; light after 70 ms, click after 50, force after 3."""
    sync = sync_metrics.SyncMetrics()
    for number in range(contacts):
        at_ns = number * 2030 * MS
        off_ns = round(stamp_off_ms * MS)
        sync.handle_series(series([ContactRow(at_ns, 1)]))
        light = LightRow(at_ns + 70 * MS, at_ns + off_ns + 10 * MS, slack_ms * MS, 500)
        sync.handle_series(series([light], "uplink_video"))
        sync.handle_series(series([light], "downlink_video"))
        click = ClickRow(at_ns + 50 * MS, at_ns + off_ns, 0, 5000)
        sync.handle_series(series([click], "uplink_voice"))
        sync.handle_series(series([StepRow(at_ns + 3 * MS)]))
    sync.handle_time(100 * NS_PER_S, lambda instant_ns: instant_ns - 3 * MS)
    return sync


SENSES = ["light", "click", "force"]


def test_latencies_skews_verdicts_bounces_and_touches_beside_a_target():
    report = metrics().report(SENSES)
    assert report.events == report.senses["light"].found == 10
    assert [sense.latency_ms.p50 for sense in report.senses.values()] == [70, 50, 3]
    assert all(sense.agrees for sense in report.senses.values())
    skews = {name: skew.p50 for name, skew in report.skew_ms.items()}
    assert skews == {"video_haptic": 67, "audio_haptic": 47, "audio_video": -20}
    assert report.skew_ms["audio_video"].within == 1.0
    assert sync_metrics.disagreements(report) == []
    sync = metrics()
    sync.handle_series(series([ContactRow(50 * MS, 1), ContactRow(1000 * MS, -1)]))
    report = sync.report(SENSES)
    assert (report.events, report.bounces, report.touches_beside_targets) == (10, 1, 1)

    # The limits of the cited papers: touch 15 ms before sight, and 24 before sound.
    limits = {"audio_video": (-45, 125), "video_haptic": (-50, 15), "audio_haptic": (0, 24)}
    for name, (least_ms, most_ms) in limits.items():
        assert sync_metrics.LIMITS[name].holds(least_ms * MS) and sync_metrics.LIMITS[name].holds(
            most_ms * MS
        )
        assert not sync_metrics.LIMITS[name].holds((most_ms + 1) * MS)
    assert not sync_metrics.LIMITS["audio_video"].holds(-46 * MS)
    assert sync_metrics.skew_summary("audio_haptic", [10 * MS, 30 * MS]).within == 0.5


@pytest.mark.parametrize(
    ("off_ms", "contacts", "wrong"),
    [(40, 10, 2), (-40, 10, 2), (5, 10, 1), (-3, 10, 1), (1, 10, 0), (40, 2, 0)],
)
def test_stamps_that_are_off_are_named_after_more_than_two_contacts(off_ms, contacts, wrong):
    report = metrics(off_ms, contacts).report(SENSES)
    lines = sync_metrics.disagreements(report)
    assert len(lines) == wrong
    assert all("disagree" in line for line in lines)
    # A stream that carried a page is not judged.
    page = report.senses["light"].stream
    judged = sync_metrics.disagreements(report, unjudged={page})
    assert judged == [line for line in lines if not line.startswith(page)]


def test_a_session_of_many_contacts_has_bounded_memory_and_exact_metrics():
    draw, sync, sizes = np.random.default_rng(3), sync_metrics.SyncMetrics(), []
    period_ns, count = 2030 * MS, 8000
    late_ms = draw.uniform([60, 10, 2], [90, 70, 6], (count, 3))
    for number, delays_ns in enumerate((late_ms * MS).astype(int).tolist()):
        light_ns, click_ns, force_ns = (at := number * period_ns) + np.array(delays_ns)
        sync.handle_series(series([ContactRow(at, 1), ContactRow(at + 100 * MS, 1)]))
        sync.handle_series(series([LightRow(light_ns, at, 33 * MS, 500)], "uplink_video"))
        sync.handle_series(series([ClickRow(click_ns, at, 0, 5000)], "uplink_voice"))
        sync.handle_series(series([StepRow(force_ns)]))
        sync.handle_time(at + NS_PER_S, lambda ns: ns // period_ns * period_ns)
        if number in (count // 2, count - 1):
            sizes.append(len(pickle.dumps(sync)))
    assert sizes[1] < 1.2 * sizes[0]
    sync.handle_time(at + 10 * NS_PER_S, lambda _: at)
    report = sync.report(SENSES)
    assert (report.events, report.bounces) == (count, count)
    light, click, force = late_ms.T
    metrics = [
        (sense.latency_ms, ms) for sense, ms in zip(report.senses.values(), late_ms.T, strict=True)
    ]
    metrics.append((report.skew_ms["audio_video"], click - light))
    metrics.append((report.skew_ms["video_haptic"], light - force))
    for found, exact in metrics:
        ranks = np.percentile(exact, (50, 95, 99), method="inverted_cdf")
        assert [found.p50, found.p95, found.p99] == pytest.approx(ranks, abs=0.1)
    within = np.mean(click - force <= 24)
    assert report.skew_ms["audio_haptic"].within == pytest.approx(within, 0.01)


def test_a_flash_in_a_film_or_a_click_at_a_microphone_is_no_contact():
    for sources, senses in (
        ({}, SENSES),
        ({"ground_mic": "alsa:default"}, ["light", "force"]),
        ({"ground_mic": "scene:cabin_voice"}, ["light", "force"]),
        ({"head": "film.mp4"}, ["click", "force"]),
        ({"operator_mic": "alsa:default", "operator_camera": "v4l2:/dev/video0"}, SENSES),
    ):
        setup = replace(BUILT_IN["spacejustin"], sources=sources)
        # As if each stamp were 40 ms late.
        section = sync_metrics.sync_section(setup, metrics(40), media=True)
        assert [sense for sense, found in section.senses.items() if found] == senses
        assert len(sync_metrics.disagreements(section)) == len(senses) - 1


def perceived(errors_ms, strengths=None, slack_ms=0):
    strengths = strengths or [1.0] * len(errors_ms)
    found = []
    for number, (error_ms, strength) in enumerate(zip(errors_ms, strengths, strict=True)):
        contact_ns = number * 2000 * MS
        stamp_ns = contact_ns + round(error_ms * MS)
        found.append((contact_ns, Matched(contact_ns, strength, stamp_ns, slack_ms * MS)))
    return found


@pytest.mark.parametrize(
    ("errors_ms", "options", "judged", "agrees"),
    [
        # Measured for 8 clicks in a vowel at 8 kbit/s: half of them are early.
        ([-5.3, -4.1, -3.0, -2.4, -1.4, -0.4, 0.1, 0.4], {}, 8, None),
        # Pictures may be dated up to a period late.
        ([2, 12, 21, 30, 33], {"slack_ms": 33}, 5, True),
        ([42, 52, 61, 70, 73], {"slack_ms": 33}, 5, False),
        ([-40, -30, -21, -12, -5], {"slack_ms": 33}, 5, False),
        # The clearest are judged; without clearer findings all are.
        ([0.1] * 15 + [-6.0] * 20, {"strengths": [5000.0] * 15 + [800.0] * 20}, 18, True),
        ([0.0] * 10 + [50.0] * 30, {"strengths": [1.0] * 40}, 40, False),
        # Six plosives of a voice beside contacts that nobody heard.
        ([141.6, 230.0, 420.0, 451.3, 500.0, 553.2], {}, 6, None),
        # Too few.
        ([40.0] * (LEAST_VERDICT - 1), {}, LEAST_VERDICT - 1, None),
        ([], {}, 0, None),
    ],
)
def test_the_clearest_findings_make_the_verdict(errors_ms, options, judged, agrees):
    verdict = judge(perceived(errors_ms, **options))
    assert (verdict.judged, verdict.agrees) == (judged, agrees)
    assert judge([(0, Matched(1))] * 20).agrees is None


@pytest.mark.parametrize("count", [6, 8, 9, 20, 51])
def test_the_interval_misses_the_true_median_once_in_twenty_at_most(count):
    rng = random.Random(count)
    missed = 0
    for _ in range(2000):
        low, high = median_interval(sorted(rng.randrange(-1000, 1001) for _ in range(count)))
        missed += not low <= 0 <= high
    assert missed < 0.06 * 2000
