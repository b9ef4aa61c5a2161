"""Files as sources, on virtual time: pace, loop, aspect, and faulty files."""

import os
import tempfile
from fractions import Fraction
from itertools import pairwise
from pathlib import Path

import av
import av.filter
import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kontur_av.clock import NS_PER_MS, NS_PER_S, ManualClock
from kontur_av.errors import ConfigError
from kontur_av.media import empty_picture, planes
from kontur_av.sources import check_spec, open_audio, open_video
from kontur_av.sources.file import _TimeLine
from kontur_av.sources.fit import Fitter
from kontur_av.sources.source import RETRY_NS


def write_video(path, *, size=(64, 48), fps=25, pictures=10, codec="libx264", first=40, form=""):
    """Write grey pictures, each brighter than the one before."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=fps)
        stream.width, stream.height, stream.pix_fmt = *size, form or "yuv420p"
        for k in range(pictures):
            container.mux(stream.encode(grey(size, first + 15 * k, stream.pix_fmt)))
        container.mux(stream.encode(None))


def grey(size, level, form="yuv420p"):
    frame = av.VideoFrame(*size, form)
    for plane, value in zip(frame.planes, (level, 128, 128), strict=True):
        plane.update(bytes([value]) * plane.buffer_size)
    return frame


def tone(rate_hz, seconds, hertz=440):
    at = np.arange(int(rate_hz * seconds)) / rate_hz
    samples = (np.sin(2 * np.pi * hertz * at) * 12_000).astype(np.int16)
    frame = av.AudioFrame.from_ndarray(samples[None], format="s16", layout="mono")
    frame.sample_rate = rate_hz
    return samples, frame


def write_tone(path, *, rate_hz=16_000, seconds=0.55):
    samples, frame = tone(rate_hz, seconds)
    with av.open(str(path), "w") as container:
        stream = container.add_stream("pcm_s16le", rate=rate_hz, layout="mono")
        container.mux([*stream.encode(frame), *stream.encode(None)])
    return samples


def video(path, clock=None, size=(64, 48), fps=30):
    width, height = size
    clock = clock or ManualClock(0)
    return open_video(str(path), name="head", width=width, height=height, fps=fps, clock=clock)


def audio(path, clock=None):
    return open_audio(str(path), name="ground_mic", clock=clock or ManualClock(0))


def take(source, count, size=(64, 48)):
    """Return (stamp, mean luma) of each picture."""
    picture, result = empty_picture(*size), []
    for _ in range(count):
        stamp = source.read(picture, NS_PER_S)
        result.append((stamp, planes(picture)[0].mean()))
    return result


def gaps_ms(stamps):
    return [(b.capture_ns - a.capture_ns) / NS_PER_MS for a, b in pairwise(stamps)]


@pytest.mark.parametrize("name", ["clip.mp4", "clip.mkv"])
def test_a_file_keeps_its_own_pace_and_loops(tmp_path, name):
    write_video(tmp_path / name)
    seen = take(video(tmp_path / name, ManualClock(7)), 25)
    assert gaps_ms(stamp for stamp, _ in seen) == pytest.approx([40] * 24, abs=1)
    assert [stamp.sequence for stamp, _ in seen] == list(range(25))
    levels = [40 + 15 * (k % 10) for k in range(25)]
    assert [level for _, level in seen] == pytest.approx(levels, abs=4)


def test_a_picture_is_not_written_before_it_is_due_and_a_late_reader_gets_the_present_one(tmp_path):
    write_video(tmp_path / "clip.mp4")
    clock, picture = ManualClock(0), np.zeros_like(empty_picture(64, 48))
    source = video(tmp_path / "clip.mp4", clock)
    take(source, 1)
    assert source.read(picture, 5 * NS_PER_MS) is None
    assert clock.now_ns() == 5 * NS_PER_MS
    assert not picture.any()
    clock = ManualClock(0)
    source = video(tmp_path / "clip.mp4", clock)
    take(source, 1)
    clock.advance_ns(210 * NS_PER_MS)
    (stamp, level), (after, _) = take(source, 2)
    assert stamp.capture_ns == 200 * NS_PER_MS
    assert abs(level - (40 + 15 * 5)) < 4
    assert (stamp.sequence, after.sequence) == (1, 2)
    clock.advance_ns(60 * NS_PER_S)
    stamps = [s for s, _ in take(source, 5)]
    assert stamps[0].capture_ns >= 60 * NS_PER_S
    assert gaps_ms(stamps) == pytest.approx([40] * 4, abs=1)


def test_a_single_picture_is_repeated(tmp_path):
    rgb = av.VideoFrame.from_ndarray(np.full((48, 64, 3), 180, np.uint8), format="rgb24")
    rgb.save(str(tmp_path / "still.png"))
    gaps = gaps_ms(stamp for stamp, _ in take(video(tmp_path / "still.png"), 6))
    assert gaps[0] < 74
    assert gaps[1:] == pytest.approx([1000 / 30] * 4, abs=1e-5)


def test_a_file_with_nothing_in_it_says_so_and_is_not_opened_over_and_over(tmp_path, monkeypatch):
    (tmp_path / "head.y4m").write_bytes(b"YUV4MPEG2 W64 H48 F25:1 Ip C420jpeg\n")
    source = video(tmp_path / "head.y4m")
    assert source.read(empty_picture(64, 48), NS_PER_S) is None
    assert source.last_fault.endswith("head.y4m: it holds no picture")
    write_tone(tmp_path / "tone.wav", seconds=0.001)
    clock, opened, before = ManualClock(0), [], av.open
    source = audio(tmp_path / "tone.wav", clock)
    monkeypatch.setattr(av, "open", lambda *args, **rest: opened.append(0) or before(*args, **rest))
    while clock.now_ns() < NS_PER_S:
        assert source.read(20 * NS_PER_MS) is None
    assert source.last_fault.endswith("tone.wav: it holds less than 5 ms of sound")
    # Each try opens it for its times and for its samples.
    assert len(opened) <= 2 * (1 + NS_PER_S // RETRY_NS)


@pytest.mark.parametrize("pictures", [1, 3])
def test_pictures_that_cannot_be_fitted_end_no_read(tmp_path, monkeypatch, pictures):
    path = tmp_path / "clip.mkv"
    write_video(path, pictures=pictures)
    source = video(path, fps=25)
    tried = iter(range(100))

    def refuse(*_):
        # StopIteration ends a source that tries without end.
        next(tried)
        raise ValueError("no such colours")

    with monkeypatch.context() as patched:
        patched.setattr(Fitter, "scale", refuse)
        assert source.read(empty_picture(64, 48), 400 * NS_PER_MS) is None
    assert 0 < source.faults < 20 and "no such colours" in source.last_fault
    assert source.read(empty_picture(64, 48), NS_PER_S) is not None


def test_a_file_that_disappears_is_cut_or_returns_in_another_form(tmp_path):
    path, tone, into = tmp_path / "clip.mkv", tmp_path / "tone.wav", empty_picture(64, 48)
    write_video(path, pictures=5)
    write_tone(tone, seconds=0.2)
    source, sound = video(path), audio(tone)
    take(source, 5)
    assert all(sound.read(NS_PER_S) for _ in range(9))
    tone.unlink()
    path.unlink()
    assert [source.read(into, 100 * NS_PER_MS) for _ in range(20)] == [None] * 20
    assert [sound.read(100 * NS_PER_MS) for _ in range(30)][-1] is None
    assert 1 <= source.faults <= 5 and sound.faults >= 1
    assert "clip.mkv" in source.last_fault
    write_video(path, size=(96, 96), fps=50, pictures=5, first=120)
    write_tone(tone, seconds=0.2)
    assert any(sound.read(NS_PER_S) for _ in range(5))
    (stamp, level), (after, _) = [s for s in take(source, 12) if s[0] is not None][:2]
    assert stamp.sequence == 5
    assert gaps_ms([stamp, after]) == pytest.approx([20], abs=1)
    assert level > 60
    write_video(path, codec="rawvideo")
    source = video(path)
    take(source, 3)
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])
    assert all(stamp is not None for stamp, _ in take(source, 30))


def test_broken_jpegs_are_left_out(tmp_path):
    path = tmp_path / "camera.avi"
    write_video(path, codec="mjpeg", size=(320, 240), form="yuvj420p")
    film = bytearray(path.read_bytes())
    chunk = film.index(b"movi")
    for number in range(10):
        chunk = film.index(b"00dc", chunk + 4)
        if number in (0, 4):
            # The camera stopped in the midst of it.
            size = int.from_bytes(film[chunk + 4 : chunk + 8], "little")
            scan = film.index(b"\xff\xda", chunk) + 40
            film[scan : chunk + 8 + size] = b"\xff\xd9" + bytes(chunk + 6 + size - scan)
    path.write_bytes(film)
    source = video(path, size=(320, 240))
    levels = [level for _, level in take(source, 8, size=(320, 240))]
    # Written with full range, read with 16 to 235.
    wanted = [50 + 12.9 * number for number in range(10) if number not in (0, 4)]
    assert levels == pytest.approx(wanted, abs=5)
    assert source.faults == 2


def png(width, height):
    return cv2.imencode(".png", np.zeros((height, width), np.uint8))[1].tobytes()


def test_pictures_too_large_for_the_memory_are_left_out(tmp_path):
    still, film = tmp_path / "huge.png", tmp_path / "grows.mov"
    still.write_bytes(png(9000, 9000))
    with pytest.raises(ConfigError, match="pictures of 9000x9000: scale them to 8192x8192"):
        check_spec(str(still), "video")
    with av.open(str(film), "w") as container:
        stream = container.add_stream("png", rate=25)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "gray"
        for k in range(10):
            packet = av.Packet(png(9000, 9000) if k == 5 else png(64, 48))
            packet.pts = packet.dts = 40 * k
            packet.time_base, packet.stream = Fraction(1, 1000), stream
            container.mux(packet)
    source = video(film)
    stamps = [stamp.capture_ns // NS_PER_MS for stamp, _ in take(source, 9)]
    assert source.faults and {160, 240} <= set(stamps)


def test_sound_comes_in_blocks_without_a_gap_where_it_loops(tmp_path):
    spoken = write_tone(tmp_path / "tone.wav", rate_hz=48_000, seconds=0.55)
    clock = ManualClock(3)
    source = audio(tmp_path / "tone.wav", clock)
    blocks = [source.read(NS_PER_S) for _ in range(60)]
    assert {(b.samples.shape, b.samples.dtype) for b in blocks} == {((960,), np.dtype(np.int16))}
    heard = np.concatenate([b.samples for b in blocks])
    assert np.array_equal(heard, np.resize(spoken, len(heard)))
    stamps = [b.stamp for b in blocks]
    assert gaps_ms(stamps) == [20] * 59
    assert [s.sequence for s in stamps] == list(range(60))
    assert clock.now_ns() == stamps[-1].capture_ns + 20 * NS_PER_MS
    # A late reader misses some.
    clock.advance_ns(5 * NS_PER_S)
    later = [source.read(NS_PER_S).stamp for _ in range(5)]
    assert later[0].capture_ns - stamps[-1].capture_ns > 4.9 * NS_PER_S
    assert gaps_ms(later) == [20] * 4


@pytest.mark.parametrize(
    ("spec", "kind", "words"),
    [
        ("{}/none.mp4", "video", "no file .*none.mp4.*give a media file"),
        ("{}", "video", "cannot read .*give a readable file"),
        ("{}/text.mp4", "video", "no media file"),
        ("{}/tone.wav", "video", "no pictures.*video stream"),
        ("{}/clip.mkv", "audio", "no sound.*an audio stream"),
        ("pipe:{}/none.fifo", "video", "no FIFO .*mkfifo"),
        ("{}/head.y4m", "video", "is a FIFO: write pipe:.*/head.y4m$"),
        ("{}/head.y4m", "audio", "is a FIFO, which brings no sound: give a file or alsa:DEVICE"),
        ("pipe:{}/clip.mkv", "video", "is no FIFO"),
        ("pipe:{}/clip.mkv", "audio", "wants sound"),
        ("alsa:default", "video", "wants pictures"),
        ("v4l2:/dev/video99", "video", "no camera .*plug one in"),
        ("v4l2:{}/clip.mkv", "video", "is no device"),
        ("scene:nowhere", "video", "no scene 'nowhere'.*one, two"),
        ("scene:", "video", "names nothing"),
        ("", "video", "give a media file"),
    ],
)  # fmt: skip
def test_refusals_name_the_mend_in_one_line(tmp_path, spec, kind, words):
    write_video(tmp_path / "clip.mkv", pictures=1)
    write_tone(tmp_path / "tone.wav")
    (tmp_path / "text.mp4").write_text("not a film")
    os.mkfifo(tmp_path / "head.y4m")
    with pytest.raises(ConfigError, match=words) as refusal:
        check_spec(spec.format(tmp_path), kind, ["two", "one"])
    assert "\n" not in str(refusal.value)


#: Places in the header of WAVE: format, channels, rate, and text of its LIST of comments.
FORMAT_AT, CHANNELS_AT, RATE_AT, TEXT_AT = 20, 22, 24, 56


@pytest.mark.parametrize(
    ("at", "octets", "words"),
    [
        (FORMAT_AT, b"\x34\x12", "no sound that FFmpeg can decode"),
        (RATE_AT, b"\x00\x00\x00\x40", "sound at 1073741824 Hz: resample it"),
        (RATE_AT, b"\x01\x00\x00\x00", "sound at 1 Hz: resample it"),
        (CHANNELS_AT, b"\x09", "sound of 9 channels that nothing places: mix them to mono"),
        (TEXT_AT, "Grün".encode("latin-1"), ""),
    ],
)
def test_sound_that_cannot_be_played_is_refused_and_comments_in_any_charset_play(
    tmp_path, at, octets, words
):
    path = tmp_path / "tone.wav"
    write_tone(path)
    whole = bytearray(path.read_bytes())
    whole[at : at + len(octets)] = octets
    path.write_bytes(whole)
    if words:
        with pytest.raises(ConfigError, match=words):
            check_spec(str(path), "audio")
    else:
        assert audio(path).read(NS_PER_S) is not None


RATE_HZ = 48_000


def write_both(path, times_s, begin_s, seconds):
    """Write pictures of these times, and a tone of 1 kHz that begins at `begin_s`."""
    with av.open(str(path), "w") as container:
        shown = container.add_stream("rawvideo", rate=25)
        shown.width, shown.height, shown.pix_fmt = 64, 48, "yuv420p"
        shown.time_base = shown.codec_context.time_base = Fraction(1, 1000)
        heard = container.add_stream("pcm_s16le", rate=RATE_HZ, layout="mono")
        frames = []
        for number, time_s in enumerate(times_s):
            frame = grey((64, 48), 20 + 5 * (number % 43))
            frame.pts, frame.time_base = round(time_s * 1000), Fraction(1, 1000)
            frames.append((shown, frame))
        for number in range(round(seconds * 50)):
            _, frame = tone(RATE_HZ, 0.02, 1000)
            frame.time_base = Fraction(1, RATE_HZ)
            frame.pts = round(begin_s * RATE_HZ) + number * 960
            frames.append((heard, frame))
        for stream, frame in sorted(frames, key=lambda one: one[1].pts * one[1].time_base):
            container.mux(stream.encode(frame))
        for stream in container.streams:
            container.mux(stream.encode(None))


def read_s(path, seconds):
    """The instant and the luma of each picture."""
    clock, picture, found = ManualClock(0), empty_picture(64, 48), []
    source = video(path, clock, fps=25)
    while clock.now_ns() < seconds * NS_PER_S:
        if (stamp := source.read(picture, 20 * NS_PER_MS)) is not None:
            found.append((stamp.capture_ns / NS_PER_S, int(picture[24, 32])))
    assert not source.faults
    return found


def own_s(found):
    """The instants of the file's own pictures, without those that are given again."""
    before = [0, *(luma for _, luma in found)]
    return [at for (at, luma), last in zip(found, before, strict=False) if luma != last]


def tones_s(path, seconds):
    """Begin of each tone: sound after 30 ms of silence."""
    clock, blocks = ManualClock(0), []
    source = audio(path, clock)
    while clock.now_ns() < seconds * NS_PER_S:
        if (block := source.read(NS_PER_S)) is not None:
            blocks.append(block.samples)
    assert not source.faults
    loud = np.flatnonzero(np.abs(np.concatenate(blocks)) > 1000)
    begins = np.diff(loud, prepend=-RATE_HZ) > 0.03 * RATE_HZ
    return list(loud[begins] / RATE_HZ)


@settings(max_examples=8, deadline=None)
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
        write_both(path, times_s, begin_s + audio_s, sound_s)
        shown = own_s(read_s(path, 3.5 * length_s))
        heard = tones_s(path, 3.5 * length_s)
    for loop in range(3):
        assert min(abs(s - video_s - loop * length_s) for s in shown) < 0.004
        if length_s - sound_s > 0.05:
            assert min(abs(s - audio_s - loop * length_s) for s in heard) < 0.004


@settings(max_examples=8, deadline=None)
@given(
    gaps_s=st.lists(st.sampled_from([0.04, 0.04, 0.2, 0.5, 3]), min_size=2, max_size=9),
    sound_s=st.sampled_from([0.1, 4]),
)
def test_a_still_picture_is_given_again_before_it_is_stale(gaps_s, sound_s):
    times_s = [sum(gaps_s[:number]) for number in range(len(gaps_s) + 1)]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "clip.mkv")
        write_both(path, times_s, 0, sound_s)
        length_s = max(times_s[-1] + 0.04, sound_s)
        found = read_s(path, 2.2 * length_s)
    gaps = [after - before for (before, _), (after, _) in pairwise(found)]
    assert max(gaps) < 0.201
    assert min(gaps) > 0.035
    # A picture that is given again is the one before the pause.
    own = own_s(found)
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
    picture, pictures = empty_picture(64, 48), []
    source = video(tmp_path / "fields.mpg", fps=25)
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
    source = audio(tmp_path / "joined.ts")
    heard = np.concatenate([source.read(NS_PER_S).samples for _ in range(95)])
    assert not source.faults
    parts = heard[: 95 // 19 * 19 * 960].reshape(-1, 960)
    assert np.mean(np.abs(parts).max(axis=1) > 3000) > 0.9
