"""Stamps and content of a session agree, and a broken stamp is noticed."""

from dataclasses import replace

import pytest

from kontur_av.clock import NS_PER_MS
from kontur_av.media import CaptureStamp
from kontur_av.streams import voice_sender
from kontur_av.streams.video_receiver import VideoReceiver
from pipelines.session.setup.table import Setup, VideoStream, VoiceStream
from pipelines.virtual.simulate import simulate
from telepresence.haptics.loop import HapticLink
from telepresence.link.radio import load_radio

SECONDS = 14.0
DELAY_MS = 2.0
SETUP = Setup(
    name="eyes and ears",
    cameras=("left",),
    uplink_video=VideoStream(name="uplink_video", cap_bps=60_000, width=320, height=240),
    # A larger cap than usual, because a loud vowel hides less of a click then.
    uplink_voice=VoiceStream(name="uplink_voice", cap_bps=24_000),
    downlink_video=None,
    downlink_voice=None,
)


@pytest.fixture(scope="module")
def setup(tmp_path_factory):
    radio = tmp_path_factory.mktemp("radio") / "straight.toml"
    radio.write_text(f"delay_ms = {DELAY_MS}\n")
    wide = replace(SETUP.uplink, frame_octets=64, pointer_in_vcid=False)
    return replace(SETUP, radio=load_radio(str(radio)), uplink=wide, sources={"left": "scene:left"})


@pytest.fixture(scope="module")
def honest(setup):
    return simulate(setup, seconds=SECONDS, seed=1)


@pytest.fixture(scope="module")
def broken(setup):
    """The same session with every stamp shifted by an amount that would spoil a result."""
    with pytest.MonkeyPatch.context() as patch:
        shown, heard, felt = (
            VideoReceiver.handle_picture,
            voice_sender.heard_stamp,
            HapticLink.take_sent_stamps,
        )

        def later(stamp: CaptureStamp | None, by_ms: int) -> CaptureStamp | None:
            if stamp is None:
                return None
            return replace(stamp, capture_ns=stamp.capture_ns + by_ms * NS_PER_MS)

        patch.setattr(
            VideoReceiver,
            "handle_picture",
            lambda *args, **options: later(shown(*args, **options), 40),
        )
        patch.setattr(voice_sender, "heard_stamp", lambda stamp: later(heard(stamp), 5))
        patch.setattr(
            HapticLink,
            "take_sent_stamps",
            lambda link: [(number, at - 5 * NS_PER_MS) for number, at in felt(link)],
        )
        return simulate(setup, seconds=SECONDS, seed=1)


def test_stamps_and_content_agree(honest):
    sync = honest.sync
    assert sync.events >= 5
    for sense, period_ms, share in (("light", 1000 / 30, 0.8), ("click", 0, 0.5), ("force", 0, 1)):
        metrics = sync.senses[sense]
        assert metrics.agrees is True, metrics
        assert metrics.perceived >= share * sync.events
        content, stamps = metrics.latency_ms.p50, metrics.stamped_latency_ms.p50
        assert -2 <= content - stamps <= period_ms + 2
    assert honest.failures == []


def test_skews_by_content_are_those_by_stamps(honest):
    period_ms = 1000 / 30
    content, stamps = honest.sync.skew_ms, honest.skew_ms
    # By content a light waits for the next picture; by the stamps nothing waits.
    assert -2 <= content["video_haptic"].p50 - stamps["video_haptic"].p50 <= period_ms + 2
    assert abs(content["audio_haptic"].p50 - stamps["audio_haptic"].p50) <= 2


@pytest.mark.parametrize(
    ("sense", "stream", "off_ms"),
    [("light", "uplink_video", 40), ("click", "uplink_voice", 5), ("force", "haptic_up", -5)],
)
def test_a_broken_stamp_is_noticed(honest, broken, sense, stream, off_ms):
    metrics = broken.sync.senses[sense]
    assert metrics.agrees is False
    before = honest.sync.senses[sense].stamp_error_ms.p50
    assert metrics.stamp_error_ms.p50 - before == pytest.approx(off_ms, abs=2.5)
    (line,) = (one for one in broken.failures if one.startswith(stream) and "disagree" in one)
    assert "stamps and content disagree" in line
