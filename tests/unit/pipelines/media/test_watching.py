"""The detectors at the operator report what they found, with its stamps."""

import numpy as np

from kontur_av.clock import NS_PER_MS
from kontur_av.detect import Click, Light
from kontur_av.media import CaptureStamp, empty_picture
from pipelines.media.showing import Recall, Watching, tell_click, tell_light
from pipelines.session.figures import ClickRow, LightRow
from pipelines.session.probe import Probe

LATE_NS = 60 * NS_PER_MS


def test_a_light_has_the_capture_times_of_its_picture_and_of_the_one_before():
    probe = Probe()
    watching = Watching(probe)
    for number in range(8):
        picture = empty_picture(320, 240)
        picture[:240], picture[240:] = 60, 128
        if number >= 4:
            picture[100:110, 150:160] = 220
        capture_ns = 40 * number * NS_PER_MS
        stamp = CaptureStamp(capture_ns, number, "uplink_video")
        watching.handle_picture("uplink_video", picture, stamp, capture_ns + LATE_NS)
    instant_ns, capture_ns, slack_ns, strength = probe.series(LightRow, "uplink_video").values
    assert (instant_ns, capture_ns) == (160 * NS_PER_MS + LATE_NS, 160 * NS_PER_MS)
    assert slack_ns == 40 * NS_PER_MS
    assert strength > 0


def test_a_click_has_the_capture_time_of_its_own_sample():
    probe = Probe()
    watching = Watching(probe)
    heard = np.zeros(48_000)
    k = np.arange(900) / 48_000
    heard[24_480:25_380] = 9000 * np.exp(-k / 0.004) * np.sin(2 * np.pi * 2500 * k)
    for number, block in enumerate(heard.astype(np.int16).reshape(-1, 960)):
        capture_ns = 20 * number * NS_PER_MS
        stamp = CaptureStamp(capture_ns, number, "uplink_voice")
        watching.handle_sound("uplink_voice", block, stamp, capture_ns + LATE_NS)
    instant_ns, capture_ns, slack_ns, _ = probe.series(ClickRow, "uplink_voice").values
    assert abs(capture_ns - 510 * NS_PER_MS) < NS_PER_MS
    assert (instant_ns - capture_ns, slack_ns) == (LATE_NS, 0)


def test_a_light_in_an_undated_picture_is_not_reported():
    probe = Probe()
    recall = Recall(depth=2)
    for timestamp in (1, 2, 3):
        recall.add(timestamp, timestamp * NS_PER_MS)
    tell_light(probe, "uplink_video", Light(9, 2, 1, 0.5, 0.5, 100.0), recall.captured_ns)
    assert not probe.series(LightRow, "uplink_video").values
    tell_light(probe, "uplink_video", Light(9, 3, 2, 0.5, 0.5, 100.0), recall.captured_ns)
    assert list(probe.series(LightRow, "uplink_video").values) == [9, 3 * NS_PER_MS, NS_PER_MS, 100]


def test_a_click_in_a_shortened_block_is_dated_by_its_place_in_the_whole_one():
    rows = Probe()
    captured_ns = 100 * NS_PER_MS
    click = Click(
        500 * NS_PER_MS, 7, offset_ns=5 * NS_PER_MS, strength=900.0, length_ns=10 * NS_PER_MS
    )
    tell_click(rows, "uplink_voice", click, {7: captured_ns})
    assert list(rows.series(ClickRow, "uplink_voice").values) == [
        500 * NS_PER_MS, captured_ns + 10 * NS_PER_MS, 0, 900,
    ]  # fmt: skip


def test_a_shortened_voice_does_not_date_its_clicks_late():
    """Blocks are shortened by 1/40, which is half a millisecond each."""
    probe = Probe()
    watching = Watching(probe)
    player_line = np.zeros(48_000)
    k = np.arange(900) / 48_000
    # 936 of 960 samples of a block are heard. The click begins 18 ms into the captured block.
    at = 25 * 936 + round(0.018 * 48_000 * 936 / 960)
    player_line[at : at + 900] = 9000 * np.exp(-k / 0.004) * np.sin(2 * np.pi * 2500 * k)
    for number in range(50):
        block = player_line[number * 936 : (number + 1) * 936].astype(np.int16)
        stamp = CaptureStamp(20 * number * NS_PER_MS, number, "uplink_voice")
        watching.handle_sound("uplink_voice", block, stamp, round(19.5 * number * NS_PER_MS))
    _, capture_ns, _, _ = probe.series(ClickRow, "uplink_voice").values
    assert abs(capture_ns - (25 * 20 + 18) * NS_PER_MS) < 0.25 * NS_PER_MS
