"""Capacity that left-out samples give to the picture: never more than is really free."""

from dataclasses import replace

import pytest

from kontur_av.clock import NS_PER_S
from kontur_av.rtp.sender import RtpIdentity
from pipelines.media.gain import LinkedVideoSender, gain_of
from pipelines.media.stream_metrics import video_sender
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.virtual.simulate import simulate


def test_a_whole_session_gains_and_reports_it():
    setup = replace(BUILT_IN["taskboard"], radio="clean")
    plain = simulate(setup, seconds=6.0, seed=1)
    saving = simulate(replace(setup, deadband="picture"), seconds=6.0, seed=1)
    assert saving.failures == plain.failures == []
    video, before = (report.streams["uplink_video"] for report in (saving, plain))
    assert video.gained_bps > 15_000 and before.gained_bps is None
    assert video.payload_bps_mean > before.payload_bps_mean + 5_000
    # The channel is faster by what is saved, and pictures do not grow by more than that.
    assert video.latency_ms.p50 < before.latency_ms.p50
    up = saving.haptic["up"]
    assert up.saved_bps > 60_000 and up.receiver.lost == 0
    # Before the session of samples begins, each cycle greets; the first greetings have no signal.
    others = up.receiver.greetings + up.receiver.echoes
    assert 5980 <= up.sender.sent + up.sender.left_out + others <= 6000
    freed_bps = saving.link["uplink"].freed_bps
    assert freed_bps == pytest.approx(up.saved_bps, rel=0.01)
    assert plain.link["uplink"].freed_bps < 100
    # In no second it has more than its cap and the capacity that was freed.
    assert video.cap_bps < video.payload_bps_max_1s <= video.cap_bps + freed_bps


def test_freed_capacity_can_reduce_the_latency_instead():
    setup = replace(BUILT_IN["spacejustin"], radio="clean")
    reports = (
        simulate(replace(setup, deadband=deadband), seconds=6.0, seed=1)
        for deadband in ("off", "picture", "latency")
    )
    plain, larger, sooner = (report.streams["uplink_video"] for report in reports)
    assert sooner.gained_bps == 0
    assert sooner.payload_bps_mean == pytest.approx(plain.payload_bps_mean, rel=0.1)
    # Slots without a sample carry twice as much: a picture takes little more than half the time.
    assert sooner.latency_ms.p50 < plain.latency_ms.p50 - 8.0
    assert sooner.latency_ms.p99 < larger.latency_ms.p99 - 2.0


def test_the_cap_follows_the_gain_at_once_and_stays_without_one():
    setup = replace(BUILT_IN["spacejustin"], deadband="picture")
    stream = setup.uplink_video
    for gain in (gain_of(setup, stream), None):
        sender = video_sender(setup, stream, RtpIdentity(1, 2, 3), wall_offset_ns=0)
        linked, gained, channels = LinkedVideoSender(sender, stream, gain), [], []
        for tenth in range(41):
            linked.handle_freed(80_000 if tenth < 40 else 0, tenth * NS_PER_S // 10)
            gained.append(sender.cap_bps - stream.cap_bps)
            channels.append(sender.channel_bps)
        assert gained[0] == gained[-1] == 0 and channels[-1] <= channels[39]
        if gain is None:
            assert set(gained) == {0}
        else:
            assert 0.6 * 80_000 < gained[39] <= 80_000
            assert channels[39] == channels[40] + 80_000
