"""What an operator sees after a loss, a loss of signal and a camera switch: on virtual time."""

from dataclasses import replace
from fractions import Fraction

import av
import numpy as np
import pytest

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.media import VIDEO_CODECS, Quality
from pipelines.media.following import CameraFollower
from pipelines.media.showing import Showing
from pipelines.session.setup.setup_file import load_setup
from pipelines.virtual.session import Selection
from pipelines.virtual.simulate import simulate
from telepresence.link.radio import load_radio

DELAY_MS = 2.0


@pytest.fixture
def shown(monkeypatch):
    """Record (capture, instant of display, damaged) of every uplink picture."""
    pictures = []
    handle_shown = Showing.handle_shown

    def record(self, stream, stamp, now_ns):
        if stream == "uplink_video":
            pictures.append((stamp.capture_ns, now_ns, stamp.quality is Quality.DAMAGED))
        handle_shown(self, stream, stamp, now_ns)

    monkeypatch.setattr(Showing, "handle_shown", record)
    return pictures


def session(tmp_path, *, dark_s=None, codec="h264", repair="auto", **options):
    radio = tmp_path / "radio.toml"
    text = f"delay_ms = {DELAY_MS}\n"
    if dark_s is not None:
        text += f"[[blackouts]]\nstart_s = 1.5\nseconds = {dark_s}\n"
    radio.write_text(text)
    setup = load_setup("spacejustin")
    video = replace(setup.uplink_video, codec=codec)
    setup = replace(setup, uplink_video=video, radio=load_radio(str(radio)), repair=repair)
    # Nothing is asked here of what comes down, which `test_simulate.py` has after a blackout.
    setup = replace(setup, downlink_video=None, downlink_voice=None)
    report = simulate(setup, seed=2, **options)
    assert report.failures == []
    for stream in report.streams.values():
        assert stream.payload_bps_max_1s <= stream.cap_bps
        assert stream.payload_bps_max_100ms <= 1.5 * stream.cap_bps
    return report


@pytest.mark.parametrize("codec", VIDEO_CODECS)
@pytest.mark.parametrize("dark_s", [0.7, 0.9])
def test_the_first_picture_after_a_loss_of_signal_is_whole_and_early(
    tmp_path, shown, dark_s, codec
):
    session(tmp_path, dark_s=dark_s, seconds=3.2, codec=codec)
    resumed_ns = round((1.5 + dark_s) * NS_PER_S)
    capture_ns, now_ns, damaged = next(row for row in shown if row[1] > resumed_ns)
    assert not damaged
    assert now_ns - resumed_ns < 200 * NS_PER_MS
    assert capture_ns >= resumed_ns - 50 * NS_PER_MS
    assert not any(damaged for _, now_ns, damaged in shown if now_ns > resumed_ns)


# FFmpeg shows no damaged pictures of HEVC, so the display stands until the key picture.
@pytest.mark.parametrize(("codec", "most_ms"), [("h264", 150), ("h265", 250)])
def test_a_loss_without_a_loss_of_signal_heals_after_a_round_trip(tmp_path, shown, codec, most_ms):
    report = session(tmp_path, dark_s=0.03, repair="off", seconds=2.8, codec=codec)
    hit_ns = round(1.5 * NS_PER_S)
    assert report.streams["uplink_video"].rtp.rtp_lost >= 1
    counts = report.processes["uplink_video_send"].counts
    assert counts["feedback_received"] >= 1
    assert bool(counts["losses_healed"]) is (codec == "h264")
    corrupted = [now_ns for _, now_ns, damaged in shown if damaged]
    assert bool(corrupted) is (codec == "h264")
    assert all(hit_ns < now_ns < hit_ns + 250 * NS_PER_MS for now_ns in corrupted)
    instants = [now_ns for _, now_ns, _ in shown if now_ns > hit_ns - 50 * NS_PER_MS]
    assert np.diff(instants).max() < most_ms * NS_PER_MS


def test_another_camera_is_seen_within_150_ms(tmp_path, shown, monkeypatch):
    captured = []
    restamp = CameraFollower.restamp

    def record(self, stamp):
        if self.camera == "static":
            captured.append(stamp.capture_ns)
        return restamp(self, stamp)

    monkeypatch.setattr(CameraFollower, "restamp", record)
    asked_ns = 2 * NS_PER_S
    session(tmp_path, seconds=2.6, selections=[Selection(asked_ns, "static")])
    first_ns = next(now_ns for capture_ns, now_ns, _ in shown if capture_ns >= captured[0])
    # From the operator's telecommand on, with both directions of the radio.
    assert first_ns - asked_ns < 150 * NS_PER_MS


def test_a_camera_slower_than_its_stream_uses_the_cap_too(tmp_path):
    path = tmp_path / "slow.mp4"
    rng = np.random.default_rng(1)
    texture = rng.integers(0, 256, (12, 18, 3), np.uint8).repeat(40, axis=0).repeat(40, axis=1)
    with av.open(str(path), "w") as container:
        video = container.add_stream("libx264", rate=Fraction(20))
        video.width, video.height, video.pix_fmt = 640, 480, "yuv420p"
        for i in range(90):
            picture = np.ascontiguousarray(texture[:480, i % 70 : i % 70 + 640])
            picture[200:280, 4 * i : 4 * i + 80] = 255 - picture[200:280, 4 * i : 4 * i + 80]
            for packet in video.encode(av.VideoFrame.from_ndarray(picture, "rgb24")):
                container.mux(packet)
        for packet in video.encode(None):
            container.mux(packet)
    setup = replace(load_setup("taskboard"), cameras=("static",), sources={"static": str(path)})
    report = simulate(setup, seconds=6.0, seed=1)
    stream = report.streams["uplink_video"]
    # The film is played at its own instants, and again from its beginning.
    assert report.failures == [] and stream.sender.frames_captured == 120
    assert stream.displayed_hz > 18
    # With the share of one of 30 pictures a second, at most 0.71 of the cap would be used.
    assert 0.75 * stream.cap_bps < stream.payload_bps_max_1s <= stream.cap_bps
