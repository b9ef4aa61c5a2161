"""The age of what is shown, and for how long it was stale, frozen or damaged."""

from dataclasses import replace

import numpy as np
import pytest

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.media import CaptureStamp, Quality, VideoFrame, empty_picture, planes
from kontur_av.sources.stereo import StereoPair
from kontur_av.streams.staleness import Staleness, State
from pipelines.hand.safety_ends import OperatorView
from pipelines.media.figures import DisplayFigures
from pipelines.media.marking import age_words, mark_halves, mark_stale
from pipelines.media.showing import Showing
from pipelines.session.probe import Probe
from pipelines.session.setup.setup_file import BUILT_IN

MS = NS_PER_MS


def video():
    return Staleness(stale_after_ns=200 * MS, frozen_after_ns=66 * MS)


def shown(staleness, *, until_ms, begin_ms=0, latency_ms=40, damaged=False):
    """Show a picture every 33 ms; return the last one's instant."""
    for at_ms in range(begin_ms, until_ms + 1, 33):
        staleness.handle_shown((at_ms - latency_ms) * MS, at_ms * MS, damaged=damaged)
    return at_ms


def test_age_grows_between_pictures():
    staleness = video()
    assert staleness.age_ns(0) is None
    assert staleness.state(0) is State.NOTHING
    last_ms = shown(staleness, until_ms=330)
    ages = [staleness.age_ns((last_ms + later) * MS) // MS for later in (0, 10, 500)]
    assert ages == [40, 50, 540]
    states = [staleness.state((last_ms + later) * MS) for later in (65, 66, 159, 160)]
    assert states == [State.FRESH, State.FROZEN, State.FROZEN, State.STALE]
    assert staleness.stale_from_ns() == (last_ms + 160) * MS


def test_a_missing_stream_is_frozen_then_stale_until_it_returns():
    staleness = video()
    last_ms = shown(staleness, until_ms=330)
    for at_ms in range(last_ms, last_ms + 1000, 70):
        staleness.handle_time(at_ms * MS)
    shown(staleness, begin_ms=last_ms + 1000, until_ms=last_ms + 1330)
    assert (staleness.frozen.total_ns, staleness.frozen.episodes) == ((1000 - 66) * MS, 1)
    assert (staleness.stale.total_ns, staleness.stale.episodes) == ((1000 - 160) * MS, 1)
    assert staleness.damaged.total_ns == 0


def test_continuously_old_pictures_are_one_stale_episode():
    staleness = video()
    last_ms = shown(staleness, until_ms=990, latency_ms=300)
    assert (staleness.stale.total_ns, staleness.stale.episodes) == (last_ms * MS, 1)
    shown(staleness, begin_ms=last_ms + 33, until_ms=last_ms + 330)
    shown(staleness, begin_ms=last_ms + 363, until_ms=last_ms + 663, latency_ms=300)
    assert staleness.stale.episodes == 2
    assert staleness.frozen.total_ns == 0


def test_two_episodes_between_two_checks_count_as_two():
    staleness = video()
    staleness.handle_shown(0, 40 * MS)
    staleness.handle_shown(960 * MS, 1000 * MS)
    staleness.handle_time(2000 * MS)
    assert (staleness.stale.total_ns, staleness.stale.episodes) == ((800 + 840) * MS, 2)
    assert staleness.frozen.episodes == 2


def test_damage_lasts_until_a_whole_picture_is_shown():
    staleness = video()
    last_ms = shown(staleness, until_ms=330)
    last_ms = shown(staleness, begin_ms=last_ms + 33, until_ms=last_ms + 330, damaged=True)
    assert staleness.state(last_ms * MS) is State.DAMAGED
    shown(staleness, begin_ms=last_ms + 33, until_ms=last_ms + 330)
    assert (staleness.damaged.total_ns, staleness.damaged.episodes) == (330 * MS, 1)


def test_a_block_of_sound_is_new_while_it_is_played():
    staleness = Staleness(stale_after_ns=100 * MS, span_ns=20 * MS)
    for at_ms in range(0, 200, 20):
        staleness.handle_shown((at_ms - 90) * MS, at_ms * MS)
        assert staleness.age_ns((at_ms + 19) * MS) == 90 * MS
    assert staleness.stale.total_ns == 0
    assert staleness.age_ns(220 * MS) == 110 * MS
    staleness.handle_time(230 * MS)
    assert (staleness.stale.total_ns, staleness.stale.episodes) == (20 * MS, 1)


def test_sound_heard_too_late_is_stale_from_its_start():
    staleness = Staleness(stale_after_ns=100 * MS, span_ns=20 * MS)
    for at_ms in range(0, 200, 20):
        staleness.handle_shown((at_ms - 110) * MS, at_ms * MS)
    staleness.handle_time(200 * MS)
    assert (staleness.stale.total_ns, staleness.stale.episodes) == (200 * MS, 1)


def test_concealed_sound_does_not_reduce_the_age_and_is_counted():
    setup = BUILT_IN["spacejustin"]
    probe = Probe()
    streams = [setup.uplink_video, setup.uplink_voice]
    showing = Showing(setup, streams, probe)
    showing.tell(0)
    assert all(told.age_ns is None for told in probe.message.figures.values())
    for number in range(100):
        now_ns = 20 * number * MS
        captured = CaptureStamp(now_ns - 40 * MS, number, "test", rtp_timestamp=number)
        quality = Quality.FRESH if number < 10 else Quality.CONCEALED
        showing.handle_shown("uplink_voice", replace(captured, quality=quality), now_ns)
        quality = Quality.FRESH if number < 50 else Quality.DAMAGED
        showing.handle_shown("uplink_video", replace(captured, quality=quality), now_ns)
    showing.tell(2 * NS_PER_S)
    figures = probe.message.figures
    voice = figures[DisplayFigures, "uplink_voice"]
    assert (voice.frames_displayed, voice.stale_episodes) == (10, 1)
    stale_from_ms = 180 - 40 + 20 + setup.stale_after_ns(setup.uplink_voice) // MS
    assert voice.stale_ns == (2000 - stale_from_ms) * MS
    assert voice.state is State.STALE
    video = figures[DisplayFigures, "uplink_video"]
    assert video.damaged_ns == 1000 * MS
    assert (video.age_ns, video.state) == (60 * MS, State.DAMAGED)


@pytest.mark.parametrize("size", [(640, 480), (16, 16), (1920, 1080), (20, 600)])
def test_the_mark_is_red_on_the_edge_and_leaves_the_middle(size):
    width, height = size
    picture = empty_picture(width, height)
    picture[:] = 128
    mark_stale(picture, 1_300 * MS)
    luma, u, v = planes(picture)
    assert (luma[-1, 0], u[-1, 0], v[-1, 0]) == (81, 90, 240)
    assert luma[height // 2, width // 2] == 128
    if width == 640:
        assert np.count_nonzero(luma[:48] == 235) > 200, "the words"


@pytest.mark.parametrize("old", ["left", "right"])
def test_only_the_old_half_of_a_merged_picture_is_marked(old):
    picture = empty_picture(640, 480)
    picture[:] = 128
    frame = VideoFrame(picture, CaptureStamp(0, 0, old))
    stale = {"left_stale": old == "left", "right_stale": old == "right"}
    mark_halves(picture, StereoPair(frame, frame, frame.stamp, **stale), 1_300 * MS)
    halves = [
        {"left": plane[:, : plane.shape[1] // 2], "right": plane[:, plane.shape[1] // 2 :]}
        for plane in planes(picture)
    ]
    fresh = "left" if old == "right" else "right"
    assert all((half[fresh] == 128).all() for half in halves)
    assert [half[old][-1, 0] for half in halves] == [81, 90, 240]
    assert np.count_nonzero(halves[0][old][:48] == 235) > 100, "the words"


def test_an_age_is_formatted_for_people():
    ages = (0, 340 * MS, 1_300 * MS, 75 * NS_PER_S)
    assert [age_words(age_ns) for age_ns in ages] == ["0 ms", "340 ms", "1.3 s", "75 s"]
    assert age_words(None) == age_words(-NS_PER_S) == "age unknown"


def test_a_picture_of_the_future_is_stale_and_its_age_unknown():
    staleness = video()
    shown(staleness, until_ms=330, latency_ms=-50)
    assert staleness.state(330 * MS) is State.FRESH
    shown(staleness, begin_ms=363, until_ms=660, latency_ms=-3_600_000)
    assert staleness.state(660 * MS) is State.STALE and staleness.age_ns(660 * MS) is None
    shown(staleness, begin_ms=693, until_ms=990)
    assert staleness.state(990 * MS) is State.FRESH and staleness.stale.episodes == 1


def test_the_robot_counts_a_picture_of_the_future_as_too_old():
    view = OperatorView(BUILT_IN["taskboard"])
    view.handle_shown(NS_PER_S, 40 * MS)
    assert not view.is_blind(NS_PER_S)
    view.handle_shown(NS_PER_S, -3_600 * NS_PER_S)
    assert view.is_blind(NS_PER_S)
