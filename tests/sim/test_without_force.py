"""Nobody feels the robot: samples take little of the link, and pictures have the rest."""

from itertools import pairwise

import pytest

from kontur_av.clock import NS_PER_MS
from kontur_av.errors import ConfigError
from pipelines.cli import main
from pipelines.session.setup.setup_file import load_setup
from pipelines.virtual.simulate import simulate
from telepresence.haptics.pacing import SamplePace
from telepresence.haptics.sample import Command

SETUP = {
    "name": "rover",
    "cameras": ["head"],
    "axes": ["x", "y", "z", "roll", "pitch", "yaw", "gripper"],
    "force": "none",
    "uplink": {"frame_octets": 64, "slot_ms": 4},
    "uplink_video": {"cap_kbps": 85},
}


def test_seven_axes_and_85_kbps_of_picture_go_through_128_kbps():
    setup = load_setup(SETUP)
    report = simulate(setup, seconds=8.0, seed=1)
    assert report.failures == [] and setup.uplink.capacity_bps == 128_000
    video, up, down = report.streams["uplink_video"], report.haptic["up"], report.haptic["down"]
    assert 70_000 < video.payload_bps_max_1s <= 85_000 and video.display.frames_displayed > 220
    for way, rate_hz, slot_ms in ((up, 50, 4), (down, 100, 1)):
        assert way.receiver.received == pytest.approx(8 * rate_hz, rel=0.05)
        assert way.receiver.lost == 0 and way.latency_ms.p99 <= slot_ms
    assert up.axes is None and report.sync.senses["force"] is None


def test_an_option_asks_for_it_too():
    words = ["simulate", "--setup", "taskboard", "--seconds", "1", "--no-media", "-q"]
    assert main([*words, "--force", "none"]) == 0


def test_it_needs_a_rate_and_a_hand_that_feels_nothing():
    for key, value in (("command_hz", 20), ("hand", "auto"), ("deadband", "picture")):
        with pytest.raises(ConfigError, match=key):
            load_setup(SETUP | {key: value})


def test_a_flag_does_not_wait_for_its_turn_and_nothing_floods_the_link():
    pace, sent = SamplePace(50), []
    for ms in range(1000):
        # The dead-man button goes down after 311 ms, and trembles from 600 ms on.
        held = 311 <= ms < 600 or (ms >= 600 and ms % 2 == 0)
        command = Command(0.001 * ms, 0.0, 0, held, 3, 0, False, False, False, False, ())
        now_ns = ms * NS_PER_MS
        if not pace.rests(now_ns) and pace.handle_sample(command, False, now_ns):
            sent.append(ms)
    assert sent[:15] == [*range(0, 300, 20)] and 311 in sent
    gaps = {after - before for before, after in pairwise(sent)}
    assert min(gaps) >= 4 and len([ms for ms in sent if ms < 600]) <= 32
