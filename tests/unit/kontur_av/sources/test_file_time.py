"""Pictures and sound of a file stay in time: starts, pauses, loops, jumps and changes of rate."""

import tempfile
from fractions import Fraction
from itertools import pairwise
from pathlib import Path

import av
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kontur_av.clock import NS_PER_MS, NS_PER_S, ManualClock
from kontur_av.media import empty_picture
from kontur_av.sources import open_audio, open_video

RATE_HZ = 48_000


def add_pictures(container, times_s):
    stream = container.add_stream("rawvideo", rate=25)
    stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
    stream.time_base = stream.codec_context.time_base = Fraction(1, 1000)
    for time_s in times_s:
        frame = av.VideoFrame(64, 48, "yuv420p")
        for plane in frame.planes:
            plane.update(bytes([128]) * plane.buffer_size)
        frame.pts, frame.time_base = round(time_s * 1000), Fraction(1, 1000)
        yield stream, frame


def add_tone(container, begin_s, seconds):
    stream = container.add_stream("pcm_s16le", rate=RATE_HZ, layout="mono")
    for number in range(round(seconds * 50)):
        at = np.arange(number * 960, (number + 1) * 960)
        samples = (12_000 * np.sin(at * 2 * np.pi * 1000 / RATE_HZ)).astype(np.int16)
        frame = av.AudioFrame.from_ndarray(samples[None], format="s16", layout="mono")
        frame.sample_rate, frame.time_base = RATE_HZ, Fraction(1, RATE_HZ)
        frame.pts = round(begin_s * RATE_HZ) + number * 960
        yield stream, frame


def write(path, times_s, tone):
    with av.open(str(path), "w") as container:
        frames = [*add_pictures(container, times_s), *add_tone(container, *tone)]
        for stream, frame in sorted(frames, key=lambda one: one[1].pts * one[1].time_base):
            container.mux(stream.encode(frame))
        for stream in container.streams:
            container.mux(stream.encode(None))


def shown_s(path, seconds):
    clock, picture, found = ManualClock(0), empty_picture(64, 48), []
    source = open_video(str(path), name="v", width=64, height=48, fps=25, clock=clock)
    while clock.now_ns() < seconds * NS_PER_S:
        if (stamp := source.read(picture, 20 * NS_PER_MS)) is not None:
            found.append(stamp.capture_ns / NS_PER_S)
    assert not source.faults
    return found


def tones_s(path, seconds):
    """Begin of each tone: sound after 30 ms of silence."""
    clock, blocks = ManualClock(0), []
    source = open_audio(str(path), name="a", clock=clock)
    while clock.now_ns() < seconds * NS_PER_S:
        if (block := source.read(NS_PER_S)) is not None:
            blocks.append(block.samples)
    assert not source.faults
    loud = np.abs(np.concatenate(blocks)) > 1000
    found, last = [], -RATE_HZ
    for at in np.flatnonzero(loud):
        if at - last > 0.03 * RATE_HZ:
            found.append(at / RATE_HZ)
        last = at
    return found


@settings(max_examples=12, deadline=None)
@given(
    late=st.sampled_from([0, 0.2, 0.476]),
    early=st.sampled_from(["pictures", "sound"]),
    pictures=st.integers(5, 40),
    sound_s=st.sampled_from([0.3, 0.9, 1.4]),
    begin_s=st.sampled_from([0, 7]),
)
def test_sound_and_pictures_of_a_loop_do_not_drift(late, early, pictures, sound_s, begin_s):
    video_s, audio_s = (0, late) if early == "pictures" else (late, 0)
    length_s = max(video_s + pictures * 0.04, audio_s + sound_s)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "clip.mkv")
        times_s = [begin_s + video_s + 0.04 * number for number in range(pictures)]
        write(path, times_s, (begin_s + audio_s, sound_s))
        shown = shown_s(path, 3.5 * length_s)
        heard = tones_s(path, 3.5 * length_s)
    for loop in range(3):
        assert min(abs(s - video_s - loop * length_s) for s in shown) < 0.004
        if length_s - sound_s > 0.05:
            assert min(abs(s - audio_s - loop * length_s) for s in heard) < 0.004


def test_a_pause_lasts_as_long_as_the_file_says(tmp_path):
    times_s = [0, 0.04, 0.08, 14, 14.04, 14.08]
    write(tmp_path / "pause.mkv", times_s, (0, 0.1))
    shown = shown_s(tmp_path / "pause.mkv", 28.2)
    gaps = [b - a for a, b in pairwise(shown)]
    assert gaps == pytest.approx(
        [b - a for a, b in pairwise(times_s)] + [0.04] + gaps[6:], abs=1e-6
    )
    assert len([gap for gap in gaps if gap > 13]) == 2


@pytest.mark.parametrize("second", [(RATE_HZ, "stereo"), (22_050, "mono"), (44_100, "stereo")])
def test_sound_goes_on_where_its_form_changes(tmp_path, second):
    joined = b""
    for rate_hz, layout in ((RATE_HZ, "mono"), second):
        path = tmp_path / "part.ts"
        with av.open(str(path), "w", format="mpegts") as container:
            stream = container.add_stream("aac", rate=rate_hz, layout=layout)
            channels = 2 if layout == "stereo" else 1
            wave = np.sin(np.arange(rate_hz) * 2 * np.pi * 500 / rate_hz) * 0.4
            frame = av.AudioFrame.from_ndarray(
                np.tile(wave.astype(np.float32), (channels, 1)), format="fltp", layout=layout
            )
            frame.sample_rate = rate_hz
            container.mux([*stream.encode(frame), *stream.encode(None)])
        joined += path.read_bytes()
    (tmp_path / "joined.ts").write_bytes(joined)
    source = open_audio(str(tmp_path / "joined.ts"), name="a", clock=ManualClock(0))
    heard = np.concatenate([source.read(NS_PER_S).samples for _ in range(95)])
    assert not source.faults
    parts = heard[: 95 // 19 * 19 * 960].reshape(-1, 960)
    assert np.mean(np.abs(parts).max(axis=1) > 3000) > 0.9
