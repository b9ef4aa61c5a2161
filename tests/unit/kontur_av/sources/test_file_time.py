"""Pictures and sound of a file stay in time: starts, pauses, loops, jumps and changes of rate."""

import tempfile
from fractions import Fraction
from itertools import pairwise
from pathlib import Path

import av
import av.filter
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kontur_av.clock import NS_PER_MS, NS_PER_S, ManualClock
from kontur_av.media import empty_picture
from kontur_av.sources import open_audio, open_video
from kontur_av.sources.file import _TimeLine

RATE_HZ = 48_000


def add_pictures(container, times_s):
    stream = container.add_stream("rawvideo", rate=25)
    stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
    stream.time_base = stream.codec_context.time_base = Fraction(1, 1000)
    for number, time_s in enumerate(times_s):
        frame = av.VideoFrame(64, 48, "yuv420p")
        for plane in frame.planes:
            plane.update(bytes([20 + 5 * (number % 43)]) * plane.buffer_size)
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


def read_s(path, seconds):
    """The instant and the luma of each picture."""
    clock, picture, found = ManualClock(0), empty_picture(64, 48), []
    source = open_video(str(path), name="v", width=64, height=48, fps=25, clock=clock)
    while clock.now_ns() < seconds * NS_PER_S:
        if (stamp := source.read(picture, 20 * NS_PER_MS)) is not None:
            found.append((stamp.capture_ns / NS_PER_S, int(picture[24, 32])))
    assert not source.faults
    return found


def shown_s(path, seconds):
    """The instants of the file's own pictures, without those that are given again."""
    found = read_s(path, seconds)
    return [
        at
        for (at, luma), (_, before) in zip(found, [(0, 0), *found], strict=False)
        if luma != before
    ]


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


@settings(max_examples=12, deadline=None)
@given(
    gaps_s=st.lists(st.sampled_from([0.04, 0.04, 0.2, 0.5, 3]), min_size=2, max_size=9),
    sound_s=st.sampled_from([0.1, 4]),
)
def test_a_still_picture_is_given_again_before_it_is_stale(gaps_s, sound_s):
    times_s = [sum(gaps_s[:number]) for number in range(len(gaps_s) + 1)]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "clip.mkv")
        write(path, times_s, (0, sound_s))
        length_s = max(times_s[-1] + 0.04, sound_s)
        found = read_s(path, 2.2 * length_s)
    gaps = [after - before for (before, _), (after, _) in pairwise(found)]
    assert max(gaps) < 0.201
    assert min(gaps) > 0.035
    # A picture that is given again is the one before the pause.
    own = [
        at
        for (at, luma), (_, before) in zip(found, [(0, 0), *found], strict=False)
        if luma != before
    ]
    assert own[: len(times_s)] == pytest.approx(times_s, abs=1e-6)
    assert own[len(times_s)] == pytest.approx(length_s, abs=0.004)


STEP = Fraction(1, 25)


@given(
    st.lists(st.tuples(st.sampled_from([0, 0, 11, 40_000, -7]), st.integers(1, 9)), max_size=6),
    st.booleans(),
    st.sampled_from([0, 7, -1]),
)
def test_a_line_of_time_goes_on_where_joined_files_begin_anew(jumps, jumping, begin_s):
    longest_s = 10 if jumping else 30 * 3600
    line = _TimeLine(Fraction(begin_s), longest_s)
    file_s, due_s = Fraction(begin_s), Fraction(0)
    for jump_s, packets in [(0, 3), *jumps]:
        file_s += jump_s
        # A jump within the longest pause is a pause.
        due_s += jump_s if 0 < jump_s < longest_s else 0
        for _ in range(packets):
            for stream in (0, 1):
                assert file_s + line.handle_packet(stream, file_s, file_s, STEP) == due_s
            file_s, due_s = file_s + STEP, due_s + STEP
    assert line.end_s == due_s


def test_a_line_of_time_ends_with_what_is_shown_last():
    line = _TimeLine(Fraction(0), 10)
    assert line.handle_packet(0, -STEP, 0 * STEP, STEP) == 0
    assert line.handle_packet(0, 0 * STEP, 2 * STEP, STEP) == 0
    assert line.handle_packet(0, STEP, STEP, STEP) == 0
    assert line.end_s == 3 * STEP


def test_a_picture_of_two_fields_has_no_combs(tmp_path):
    # PyAV cannot say itself that a picture has fields.
    fields = av.filter.Graph()
    form = av.VideoFormat("yuv420p")
    entry = fields.add_buffer(width=64, height=48, format=form, time_base=Fraction(1, 25))
    fields.link_nodes(entry, fields.add("setfield", "tff"), fields.add("buffersink")).configure()
    with av.open(str(tmp_path / "fields.mpg"), "w") as container:
        stream = container.add_stream("mpeg2video", rate=25)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        stream.codec_context.flags |= 1 << 18 | 1 << 29
        stream.bit_rate = 4_000_000
        for number in range(12):
            rows = np.full((72, 64), 128, np.uint8)
            rows[:48] = 60
            # A bar that moves between the fields.
            for field in (0, 1):
                left = 4 * number + 2 * field
                rows[field:48:2, left : left + 12] = 200
            frame = av.VideoFrame.from_ndarray(rows, "yuv420p")
            frame.pts, frame.time_base = number, Fraction(1, 25)
            fields.vpush(frame)
            container.mux(stream.encode(fields.vpull()))
        container.mux(stream.encode(None))
    clock, picture, pictures = ManualClock(0), empty_picture(64, 48), []
    path = str(tmp_path / "fields.mpg")
    source = open_video(path, name="v", width=64, height=48, fps=25, clock=clock)
    while len(pictures) < 12:
        if (stamp := source.read(picture, 20 * NS_PER_MS)) is not None:
            pictures.append((stamp.capture_ns, picture[:48].astype(int)))
    assert [at // NS_PER_MS for at, _ in pictures] == [40 * number for number in range(12)]
    assert not source.faults
    for _, luma in pictures[2:10]:
        combs = np.abs(2 * luma[1:-1] - luma[:-2] - luma[2:]).mean(axis=0)
        assert combs.max() < 60
        assert luma.max() > 180


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
