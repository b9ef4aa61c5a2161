"""Ages on virtual time: mouth to ear, lip-sync, stale, frozen and damaged."""

from dataclasses import replace

import pytest

from kontur_av.clock import NS_PER_MS
from pipelines.report.model import CodingCosts
from pipelines.session.setup.setup_file import load_setup
from pipelines.virtual.simulate import simulate
from telepresence.link.radio import load_radio

DELAY_MS = 2.0


@pytest.fixture(scope="module")
def usual(tmp_path_factory):
    return session(tmp_path_factory.mktemp("usual"), seconds=3.0)[1]


def session(tmp_path, *, seconds, radio="", down=True, **options):
    """down: with picture and voice from space, too."""
    path = tmp_path / "radio.toml"
    path.write_text(f"delay_ms = {DELAY_MS}\n{radio}")
    setup = replace(load_setup("spacejustin"), radio=load_radio(str(path)))
    if not down:
        setup = replace(setup, downlink_video=None, downlink_voice=None)
    return setup, simulate(setup, seconds=seconds, seed=1, **options)


def test_voice_within_60_ms_and_in_sync_with_pictures(usual):
    report = usual
    for name in ("uplink_voice", "downlink_voice"):
        stream = report.streams[name]
        # A block of 20 ms, 6.5 of look-ahead, coding, slots, the radio and the playout buffer.
        assert 30 < stream.latency_ms.p50 < 50
        assert stream.latency_ms.p99 <= 60
        assert stream.display.stale_ns == 0
        assert stream.voice.frames_concealed == 0
    # From the very first picture on, although that one is large.
    assert report.lip_sync.within == 1
    assert report.skew_ms["audio_video"].p50 > -45


def test_only_sound_waits_for_late_pictures_and_no_longer_than_needed(tmp_path, usual):
    costs = CodingCosts(capture_ms=95)
    _, report = session(tmp_path, seconds=7.0, down=False, costs=costs)
    video, voice = (report.streams[name].latency_ms for name in ("uplink_video", "uplink_voice"))
    skew = report.skew_ms["audio_video"]
    # Without lip-sync the sound would be about 90 ms early; with it at most 45, and not later.
    assert video.p50 - usual.streams["uplink_voice"].latency_ms.p50 > 80
    assert -46 < skew.p50 < -15
    assert voice.max < video.max - 15
    # Except for the 1.5 s in which the voice is stretched.
    assert 0.6 < report.lip_sync.within < 1
    assert report.lip_sync.late == 0
    assert report.haptic["up"].latency_ms.max == DELAY_MS + 1
    assert report.streams["uplink_voice"].voice.frames_concealed == 0


def test_a_blackout_of_a_second_gives_a_second_of_stale_and_frozen_pictures(tmp_path):
    setup, report = session(
        tmp_path, seconds=4.5, radio="[[blackouts]]\nstart_s = 1.5\nseconds = 1.0\n"
    )
    for stream in setup.streams:
        figures = report.streams[stream.name]
        assert figures.stale_after_ms == pytest.approx(setup.stale_after_ns(stream) / 1e6, abs=1e-3)
        assert figures.display.stale_episodes == 1
        assert 1000 - figures.stale_after_ms < figures.display.stale_ns / NS_PER_MS < 1300
        if stream.name.endswith("video"):
            assert 900 < figures.display.frozen_ns / NS_PER_MS < 1500
            # A loss may damage pictures until the refresh is complete or a key picture arrives.
            assert figures.display.damaged_ns / NS_PER_MS <= 1100
        else:
            assert figures.display.frozen_ns == 0


def test_occasional_losses_count_as_damaged_and_concealed(tmp_path):
    _, report = session(tmp_path, seconds=3.0, radio="frame_loss = 0.01\n", down=False)
    video, voice = (report.streams[name] for name in ("uplink_video", "uplink_voice"))
    assert video.rtp.rtp_lost > 0
    assert 0 < video.display.damaged_ns / NS_PER_MS < 3000
    assert voice.voice.frames_concealed > 0
    assert voice.display.stale_ns == 0
    # A loss delays nothing.
    assert voice.latency_ms.p99 <= 60


def test_a_stream_always_above_its_age_limit_is_always_stale(tmp_path):
    setup = load_setup("taskboard")
    setup = replace(setup, uplink_video=replace(setup.uplink_video, stale_after_ms=20))
    figures = simulate(setup, seconds=2.0, seed=1).streams["uplink_video"]
    assert figures.display.stale_episodes == 1
    assert figures.display.stale_ns / NS_PER_MS == pytest.approx(2000, abs=250)
