"""Findings are assigned to contacts, and figures are computed from them."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from told import series

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.meters import rank_of
from pipelines.report.sync_figures import (
    LIMITS,
    SyncFigures,
    disagreements,
    skew_summary,
    sync_section,
)
from pipelines.report.sync_matching import Matched, match
from pipelines.session.figures import ClickRow, ContactRow, LightRow, StepRow
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


def test_the_usual_delay_decides_between_candidates():
    contacts = [second * 2 * NS_PER_S for second in range(10)]
    found = [at(second * 2000 + 80, 1.0) for second in range(10)]
    # Stronger findings, at another time after each contact.
    found += [at(second * 2000 + 300 + 97 * second, 1.5) for second in range(10)]
    found.sort(key=lambda one: one.instant_ns)
    assert [one.instant_ns % (2 * NS_PER_S) for one in match(contacts, found)] == [80 * MS] * 10


def test_a_weak_and_distant_finding_is_ignored():
    contacts = [second * 2 * NS_PER_S for second in range(8)]
    found = [at(second * 2000 + 80, 10.0) for second in range(8) if second != 4]
    found += [at(4 * 2000 + 900, 3.0)]
    assert match(contacts, sorted(found, key=lambda one: one.instant_ns))[4] is None


def test_nothing_is_perceived_sooner_than_it_can_be():
    assert match([0], [at(200)], soonest_ns=250 * MS) == [None]
    assert match([0], [at(200), at(320)], soonest_ns=250 * MS) == [at(320)]


def test_without_contacts_or_findings_there_is_nothing():
    assert match([], [at(1)]) == []
    assert match([0, NS_PER_S], []) == [None, None]


def figures(stamp_off_ms=0.0, contacts=10, slack_ms=33):
    """Contacts 2.03 s apart; light after 70 ms, click after 50, force after 3."""
    sync = SyncFigures()
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


def test_latencies_skews_and_verdicts():
    report = figures().report(["light", "click", "force"])
    assert report.events == 10
    assert [report.senses[sense].latency_ms.p50 for sense in report.senses] == [
        70,
        50,
        3,
    ]
    assert all(sense.agrees for sense in report.senses.values())
    assert {name: skew.p50 for name, skew in report.skew_ms.items()} == {
        "video_haptic": 67,
        "audio_haptic": 47,
        "audio_video": -20,
    }
    assert report.skew_ms["audio_video"].within == 1.0
    assert report.senses["light"].found == 10
    assert disagreements(report) == []


@pytest.mark.parametrize(("off_ms", "wrong"), [(40, 2), (-40, 2), (5, 1), (-3, 1), (1, 0)])
def test_stamps_that_are_off_are_named(off_ms, wrong):
    lines = disagreements(figures(off_ms).report(["light", "click", "force"]))
    assert len(lines) == wrong
    assert all("disagree" in line for line in lines)


def test_a_stream_that_carried_a_page_is_not_judged():
    report = figures(40).report(["light", "click", "force"])
    (line,) = disagreements(report, unjudged={report.senses["light"].stream})
    assert line.startswith(report.senses["click"].stream)


def test_two_contacts_make_no_verdict():
    report = figures(40, contacts=2).report(["light", "click", "force"])
    assert report.senses["light"].agrees is None
    assert disagreements(report) == []


def test_bounces_and_touches_beside_a_target_are_distinguished():
    sync = figures()
    sync.handle_series(series([ContactRow(50 * MS, 1), ContactRow(1000 * MS, -1)]))
    report = sync.report(["light", "click", "force"])
    assert (report.events, report.bounces, report.touches_beside_targets) == (10, 1, 1)


@pytest.mark.parametrize("late_ms", [1, 11, 200])
def test_the_last_contact_is_not_missed_because_its_force_has_no_stamp_yet(late_ms):
    soonest_ns, end_ns = min(late_ms, 10) * MS, 20 * NS_PER_S
    for before_end_ms in range(900, 1300, 10):
        sync = SyncFigures(soonest_ns=soonest_ns)
        for at_ns in (9 * NS_PER_S, end_ns - before_end_ms * MS):
            sync.handle_series(series([ContactRow(at_ns, 0)]))
            sync.handle_series(series([StepRow(at_ns + late_ms * MS)]))
        sync.handle_time(end_ns, lambda instant_ns: instant_ns)
        assert sync.report(["force"]).senses["force"].missed == 0


def test_a_session_of_many_contacts_has_bounded_memory_and_percentiles_to_a_tenth_of_a_ms():
    draw, sync, sizes = np.random.default_rng(3), SyncFigures(), []
    # 11 hours of contacts with light, click and force.
    period_ns = 2030 * MS
    late_ns = draw.uniform([60, 10, 2], [90, 70, 6], (20_000, 3)) * MS
    for number, delays_ns in enumerate(late_ns.astype(int).tolist()):
        light_ns, click_ns, force_ns = (at := number * period_ns) + np.array(delays_ns)
        sync.handle_series(series([ContactRow(at, 1), ContactRow(at + 100 * MS, 1)]))
        sync.handle_series(series([LightRow(light_ns, at, 33 * MS, 500)], "uplink_video"))
        sync.handle_series(series([ClickRow(click_ns, at, 0, 5000)], "uplink_voice"))
        sync.handle_series(series([StepRow(force_ns)]))
        sync.handle_time(at + NS_PER_S, lambda ns: ns // period_ns * period_ns)
        if number in (10_000, 19_999):
            sizes.append(len(pickle.dumps(sync)))
    assert sizes[1] < 1.2 * sizes[0]
    sync.handle_time(at + 10 * NS_PER_S, lambda _: at)
    report = sync.report(["light", "click", "force"])
    assert (report.events, report.bounces) == (20_000, 20_000)
    light, click, force = (late_ns / MS).T
    for sense, exact in zip(report.senses.values(), (light, click, force), strict=True):
        assert (sense.perceived, sense.found, sense.agrees) == (20_000, 20_000, True)
        assert within(sense.latency_ms, exact)
        assert within(sense.stamped_latency_ms, exact)
        assert abs(sense.stamp_error_ms.max) < 0.1
    assert within(report.skew_ms["audio_video"], click - light)
    assert within(report.skew_ms["video_haptic"], light - force)
    assert report.skew_ms["audio_haptic"].within == pytest.approx(
        np.mean(click - force <= 24), 0.01
    )


def within(found, exact_ms):
    """Whether percentiles are exact to 0.1 ms."""
    exact = [np.percentile(exact_ms, p, method="inverted_cdf") for p in (50, 95, 99)]
    exact.append(max(exact_ms, key=abs))
    return [found.p50, found.p95, found.p99, found.max] == pytest.approx(exact, abs=0.1)


def test_a_sense_that_a_setup_lacks_has_no_figures():
    report = figures().report(["light", "force"])
    assert report.senses["click"] is None
    assert [name for name, skew in report.skew_ms.items() if skew] == ["video_haptic"]
    assert SyncFigures().report(["light"]) is None


@pytest.mark.parametrize(
    ("sources", "senses"),
    [
        ({}, ["light", "click", "force"]),
        ({"ground_mic": "alsa:default"}, ["light", "force"]),
        ({"ground_mic": "scene:cabin_voice"}, ["light", "force"]),
        ({"head": "film.mp4"}, ["click", "force"]),
        (
            {"iss_mic": "alsa:default", "iss_camera": "v4l2:/dev/video0"},
            ["light", "click", "force"],
        ),
    ],
)
def test_a_flash_in_a_film_or_a_click_at_a_microphone_is_no_contact(sources, senses):
    setup = replace(BUILT_IN["spacejustin"], sources=sources)
    # As if each stamp were 40 ms late.
    section = sync_section(setup, figures(40), media=True)
    assert [sense for sense, found in section.senses.items() if found] == senses
    assert len(disagreements(section)) == len(senses) - 1


def test_limits_equal_those_in_the_cited_papers():
    assert LIMITS["audio_video"].holds(125 * MS)
    assert LIMITS["audio_video"].holds(-45 * MS)
    assert not LIMITS["audio_video"].holds(-46 * MS)
    assert LIMITS["video_haptic"].holds(15 * MS)  # touch 15 ms before sight
    assert not LIMITS["video_haptic"].holds(16 * MS)
    assert LIMITS["video_haptic"].holds(-50 * MS)
    assert not LIMITS["audio_haptic"].holds(25 * MS)
    assert skew_summary("audio_haptic", [10 * MS, 30 * MS]).within == 0.5


@given(st.lists(st.integers(-(10**9), 10**9), min_size=1), st.sampled_from((50, 95, 99)))
def test_a_percentile_is_the_value_at_the_nearest_rank(values, p):
    ordered = sorted(values)
    value = ordered[rank_of(p, len(ordered)) - 1]
    assert sum(one <= value for one in ordered) * 100 >= p * len(ordered)
    assert sum(one < value for one in ordered) * 100 < p * len(ordered)
