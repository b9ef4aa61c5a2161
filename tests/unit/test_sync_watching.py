"""The operator's eye and ear put rows into the probe that say what was found, and its stamps."""

import numpy as np

from kontur_av.clock import NS_PER_MS
from kontur_av.detect import Light
from kontur_av.media import CaptureStamp, empty_picture
from pipelines.probe import Probe
from pipelines.sync.watching import Recall, Watching, tell_light

LATE_NS = 60 * NS_PER_MS


def test_a_light_is_told_with_the_capture_of_its_picture_and_of_the_one_before():
    probe = Probe(None)
    watching = Watching(probe)
    for number in range(8):
        picture = empty_picture(320, 240)
        picture[:240], picture[240:] = 60, 128
        if number >= 4:
            picture[100:110, 150:160] = 220
        capture_ns = 40 * number * NS_PER_MS
        stamp = CaptureStamp(capture_ns, number, "uplink_video")
        watching.handle_picture("uplink_video", picture, stamp, capture_ns + LATE_NS)
    instant_ns, capture_ns, slack_ns, strength = probe.rows("light.uplink_video")
    assert (instant_ns, capture_ns) == (160 * NS_PER_MS + LATE_NS, 160 * NS_PER_MS)
    assert slack_ns == 40 * NS_PER_MS
    assert strength > 0


def test_a_click_is_told_with_the_capture_of_its_own_sample():
    probe = Probe(None)
    watching = Watching(probe)
    heard = np.zeros(48_000)
    k = np.arange(900) / 48_000
    heard[24_480:25_380] = 9000 * np.exp(-k / 0.004) * np.sin(2 * np.pi * 2500 * k)
    for number, block in enumerate(heard.astype(np.int16).reshape(-1, 960)):
        capture_ns = 20 * number * NS_PER_MS
        stamp = CaptureStamp(capture_ns, number, "uplink_voice")
        watching.handle_sound("uplink_voice", block, stamp, capture_ns + LATE_NS)
    instant_ns, capture_ns, slack_ns, _ = probe.rows("click.uplink_voice")
    assert abs(capture_ns - 510 * NS_PER_MS) < NS_PER_MS
    assert (instant_ns - capture_ns, slack_ns) == (LATE_NS, 0)


def test_a_light_in_a_picture_without_a_date_is_not_told():
    probe = Probe(None)
    recall = Recall(depth=2)
    for timestamp in (1, 2, 3):
        recall.add(timestamp, timestamp * NS_PER_MS)
    tell_light(probe, "uplink_video", Light(9, 2, 1, 0.5, 0.5, 100.0), recall.captured_ns)
    assert not probe.rows("light.uplink_video")
    tell_light(probe, "uplink_video", Light(9, 3, 2, 0.5, 0.5, 100.0), recall.captured_ns)
    assert list(probe.rows("light.uplink_video")) == [9, 3 * NS_PER_MS, NS_PER_MS, 100]
