"""Files as sources, on virtual time: pace, loop, aspect, and faulty files."""

import os
from fractions import Fraction
from itertools import pairwise
from struct import pack
from zlib import compress, crc32

import av
import numpy as np
import pytest

from kontur_av.clock import NS_PER_MS, NS_PER_S, ManualClock
from kontur_av.errors import ConfigError
from kontur_av.media import empty_picture, planes
from kontur_av.sources import check_spec, open_audio, open_video
from kontur_av.sources.fit import Fitter, fitted_size
from kontur_av.sources.source import RETRY_NS
from telepresence.world.scenes import media_folder


def write_video(
    path,
    *,
    size=(64, 48),
    fps=25,
    pictures=10,
    codec="libx264",
    first_level=40,
    form="yuv420p",
):
    """Write grey pictures, each brighter than the one before."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=fps)
        stream.width, stream.height, stream.pix_fmt = *size, form
        for k in range(pictures):
            frame = av.VideoFrame(*size, form)
            for plane, level in zip(frame.planes, (first_level + 15 * k, 128, 128), strict=True):
                plane.update(bytes([level]) * plane.buffer_size)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


def write_tone(path, *, rate_hz=16_000, seconds=0.55, hertz=440):
    t = np.arange(int(rate_hz * seconds)) / rate_hz
    samples = (np.sin(2 * np.pi * hertz * t) * 12_000).astype(np.int16)
    with av.open(str(path), "w") as container:
        stream = container.add_stream("pcm_s16le", rate=rate_hz, layout="mono")
        frame = av.AudioFrame.from_ndarray(samples[None], format="s16", layout="mono")
        frame.sample_rate = rate_hz
        container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return samples


def opened(path, clock, size=(64, 48), fps=30):
    return open_video(str(path), name="head", width=size[0], height=size[1], fps=fps, clock=clock)


def take(source, count, size=(64, 48)):
    """Return (stamp, mean luma) of each picture."""
    picture, result = empty_picture(*size), []
    for _ in range(count):
        stamp = source.read(picture, NS_PER_S)
        result.append((stamp, planes(picture)[0].mean()))
    return result


@pytest.mark.parametrize("name", ["clip.mp4", "clip.mkv"])
def test_a_file_keeps_its_own_pace_and_loops(tmp_path, name):
    write_video(tmp_path / name)
    seen = take(opened(tmp_path / name, ManualClock(7)), 25)
    gaps = [b.capture_ns - a.capture_ns for (a, _), (b, _) in pairwise(seen)]
    assert all(abs(gap - 40 * NS_PER_MS) < NS_PER_MS for gap in gaps)
    assert [s.sequence for s, _ in seen] == list(range(25))
    for k, (_, level) in enumerate(seen):
        assert abs(level - (40 + 15 * (k % 10))) < 4


def test_it_is_read_before_it_is_due_and_not_written_before(tmp_path):
    write_video(tmp_path / "clip.mp4")
    clock = ManualClock(0)
    source = opened(tmp_path / "clip.mp4", clock)
    take(source, 1)
    picture = np.zeros_like(empty_picture(64, 48))
    assert source.read(picture, 5 * NS_PER_MS) is None
    assert clock.now_ns() == 5 * NS_PER_MS
    assert not picture.any()


def test_a_late_reader_gets_the_present_picture(tmp_path):
    write_video(tmp_path / "clip.mp4")
    clock = ManualClock(0)
    source = opened(tmp_path / "clip.mp4", clock)
    take(source, 1)
    clock.advance_ns(210 * NS_PER_MS)
    (stamp, level), (after, _) = take(source, 2)
    assert stamp.capture_ns == 200 * NS_PER_MS
    assert abs(level - (40 + 15 * 5)) < 4
    assert (stamp.sequence, after.sequence) == (1, 2)
    clock.advance_ns(60 * NS_PER_S)
    stamps = [s for s, _ in take(source, 5)]
    assert stamps[0].capture_ns >= 60 * NS_PER_S
    assert all(abs(b.capture_ns - a.capture_ns - 40 * NS_PER_MS) < NS_PER_MS
               for a, b in pairwise(stamps))  # fmt: skip


@pytest.mark.parametrize(
    ("size", "aspect", "fitted"),
    [
        ((1280, 720), 1, (640, 360)),
        ((480, 640), 1, (360, 480)),
        ((720, 576), Fraction(16, 15), (640, 480)),
        ((640, 480), 1, (640, 480)),
        ((4000, 10), 1, (640, 2)),
    ],
)
def test_the_shape_is_kept(size, aspect, fitted):
    assert fitted_size(*size, Fraction(aspect), 640, 480) == fitted


def test_letterbox_is_black_and_the_picture_in_the_middle(tmp_path):
    write_video(tmp_path / "wide.mp4", size=(128, 48), first_level=200, pictures=2)
    picture = np.full_like(empty_picture(64, 48), 99)
    source = opened(tmp_path / "wide.mp4", ManualClock(0))
    assert source.read(picture, NS_PER_S) is not None
    luma, u, v = planes(picture)
    assert (luma[:12] == 16).all()
    assert (luma[36:] == 16).all()
    assert np.abs(luma[14:34].astype(int) - 200).max() < 6
    assert (u == 128).all()
    assert (v == 128).all()


def test_a_single_picture_is_repeated(tmp_path):
    rgb = av.VideoFrame.from_ndarray(np.full((48, 64, 3), 180, np.uint8), format="rgb24")
    rgb.save(str(tmp_path / "still.png"))
    seen = take(opened(tmp_path / "still.png", ManualClock(0)), 6)
    gaps = [b.capture_ns - a.capture_ns for (a, _), (b, _) in pairwise(seen)]
    assert all(abs(gap - 33_333_333) <= 40_000_000 for gap in gaps)
    assert all(abs(gap - 33_333_333) <= 1 for gap in gaps[1:])


def test_a_file_with_nothing_in_it_says_so(tmp_path):
    (tmp_path / "head.y4m").write_bytes(b"YUV4MPEG2 W64 H48 F25:1 Ip C420jpeg\n")
    video = opened(tmp_path / "head.y4m", ManualClock(0))
    assert video.read(empty_picture(64, 48), NS_PER_S) is None
    assert video.last_fault.endswith("head.y4m: it holds no picture")
    write_tone(tmp_path / "tone.wav", seconds=0.001)
    audio = open_audio(str(tmp_path / "tone.wav"), name="mic", clock=ManualClock(0))
    assert audio.read(NS_PER_S) is None
    assert audio.last_fault.endswith("tone.wav: it holds less than 5 ms of sound")


@pytest.mark.parametrize("pictures", [1, 3])
def test_pictures_that_cannot_be_fitted_end_no_read(tmp_path, monkeypatch, pictures):
    path = tmp_path / "clip.mkv"
    write_video(path, pictures=pictures)
    source = open_video(str(path), name="v", width=64, height=48, fps=25, clock=ManualClock(0))
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


def test_a_file_that_disappears_and_returns(tmp_path):
    path = tmp_path / "clip.mkv"
    write_video(path, pictures=5)
    clock = ManualClock(0)
    source = opened(path, clock)
    take(source, 5)
    path.unlink()
    picture = empty_picture(64, 48)
    waited = [source.read(picture, 100 * NS_PER_MS) for _ in range(20)]
    assert waited == [None] * 20
    assert 1 <= source.faults <= 5
    assert "clip.mkv" in source.last_fault
    write_video(path, size=(96, 96), fps=50, pictures=5, first_level=120)
    (stamp, level), (after, _) = [s for s in take(source, 12) if s[0] is not None][:2]
    assert stamp.sequence == 5
    assert abs(after.capture_ns - stamp.capture_ns - 20 * NS_PER_MS) < NS_PER_MS
    assert level > 60


def test_a_file_that_is_cut_short_while_it_plays(tmp_path):
    path = tmp_path / "clip.mkv"
    write_video(path, pictures=10, codec="rawvideo")
    source = opened(path, ManualClock(0))
    take(source, 3)
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])
    assert all(stamp is not None for stamp, _ in take(source, 30))
    path.write_bytes(b"no longer a film")
    picture = empty_picture(64, 48)
    ends = [source.read(picture, 100 * NS_PER_MS) for _ in range(40)]
    assert ends[-1] is None
    assert source.faults > 0


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
    source = opened(path, ManualClock(0), size=(320, 240))
    levels = [level for _, level in take(source, 8, size=(320, 240))]
    # Written with full range, read with 16 to 235.
    wanted = [50 + 12.9 * number for number in range(10) if number not in (0, 4)]
    assert levels == pytest.approx(wanted, abs=5)
    assert source.faults == 2


def png(width, height):
    """Return an empty black and white PNG picture."""

    def chunk(name, data):
        return pack(">I", len(data)) + name + data + pack(">I", crc32(name + data))

    header = pack(">IIBBBBB", width, height, 1, 0, 0, 0, 0)
    rows = compress(bytes(1 + -(-width // 8)) * height)
    parts = chunk(b"IHDR", header), chunk(b"IDAT", rows), chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


def test_pictures_too_large_for_the_memory_are_left_out(tmp_path):
    still, film = tmp_path / "huge.png", tmp_path / "grows.mov"
    still.write_bytes(png(9000, 9000))
    with pytest.raises(ConfigError, match="pictures of 9000x9000: scale them to 8192x8192"):
        check_spec(str(still), "video")
    with av.open(str(film), "w") as container:
        stream = container.add_stream("png", rate=25)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "monob"
        for k in range(10):
            packet = av.Packet(png(9000, 9000) if k == 5 else png(64, 48))
            packet.pts = packet.dts = 40 * k
            packet.time_base, packet.stream = Fraction(1, 1000), stream
            container.mux(packet)
    source = opened(film, ManualClock(0))
    stamps = [stamp.capture_ns // NS_PER_MS for stamp, _ in take(source, 9)]
    assert source.faults and {160, 240} <= set(stamps)


def test_sound_comes_in_blocks_without_a_gap_where_it_loops(tmp_path):
    spoken = write_tone(tmp_path / "tone.wav", rate_hz=48_000, seconds=0.55)
    clock = ManualClock(3)
    source = open_audio(str(tmp_path / "tone.wav"), name="ground_mic", clock=clock)
    blocks = [source.read(NS_PER_S) for _ in range(60)]
    assert {b.samples.shape for b in blocks} == {(960,)}
    assert {b.samples.dtype for b in blocks} == {np.dtype(np.int16)}
    heard = np.concatenate([b.samples for b in blocks])
    assert np.array_equal(heard, np.resize(spoken, len(heard)))
    stamps = [b.stamp for b in blocks]
    assert all(b.capture_ns - a.capture_ns == 20 * NS_PER_MS for a, b in pairwise(stamps))
    assert [s.sequence for s in stamps] == list(range(60))
    assert clock.now_ns() == stamps[-1].capture_ns + 20 * NS_PER_MS


def test_sound_of_another_rate_keeps_its_pitch_and_length():
    source = open_audio(str(media_folder() / "speech_ground.flac"), name="m", clock=ManualClock(0))
    heard = np.concatenate([source.read(NS_PER_S).samples for _ in range(200)])
    assert np.abs(heard).max() > 8_000


def test_late_sound_skips_what_was_missed(tmp_path):
    write_tone(tmp_path / "tone.wav")
    clock = ManualClock(0)
    source = open_audio(str(tmp_path / "tone.wav"), name="ground_mic", clock=clock)
    first = source.read(NS_PER_S)
    clock.advance_ns(5 * NS_PER_S)
    later = [source.read(NS_PER_S).stamp for _ in range(5)]
    assert later[0].capture_ns - first.stamp.capture_ns > 4.9 * NS_PER_S
    assert all(b.capture_ns - a.capture_ns == 20 * NS_PER_MS for a, b in pairwise(later))


def test_a_sound_file_that_disappears_and_returns(tmp_path):
    path = tmp_path / "tone.wav"
    write_tone(path, seconds=0.2)
    source = open_audio(str(path), name="ground_mic", clock=ManualClock(0))
    assert all(source.read(NS_PER_S) for _ in range(9))
    path.unlink()
    assert [source.read(100 * NS_PER_MS) for _ in range(30)][-1] is None
    assert source.faults >= 1
    write_tone(path, seconds=0.2)
    assert any(source.read(NS_PER_S) for _ in range(5))


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


def test_good_files_are_not_refused(tmp_path):
    write_video(tmp_path / "clip.mkv", pictures=1)
    write_tone(tmp_path / "tone.wav")
    check_spec(str(tmp_path / "clip.mkv"), "video")
    check_spec(str(tmp_path / "tone.wav"), "audio")


def change_tone(path, at, octets):
    """Write a tone with these octets at this place of its header."""
    write_tone(path)
    whole = bytearray(path.read_bytes())
    whole[at : at + len(octets)] = octets
    path.write_bytes(whole)


#: Places in the header of WAVE: format, channels, rate, and text of its LIST of comments.
FORMAT_AT, CHANNELS_AT, RATE_AT, TEXT_AT = 20, 22, 24, 56


def test_comments_in_any_charset_play(tmp_path):
    change_tone(tmp_path / "tone.wav", TEXT_AT, "Grün".encode("latin-1"))
    source = open_audio(str(tmp_path / "tone.wav"), name="mic", clock=ManualClock(0))
    assert source.read(NS_PER_S) is not None


@pytest.mark.parametrize(
    ("at", "octets", "words"),
    [
        (FORMAT_AT, b"\x34\x12", "no sound that FFmpeg can decode"),
        (RATE_AT, b"\x00\x00\x00\x40", "sound at 1073741824 Hz: resample it"),
        (RATE_AT, b"\x01\x00\x00\x00", "sound at 1 Hz: resample it"),
        (CHANNELS_AT, b"\x09", "sound of 9 channels that nothing places: mix them to mono"),
    ],
)
def test_sound_that_cannot_be_played_is_refused(tmp_path, at, octets, words):
    change_tone(tmp_path / "tone.wav", at, octets)
    with pytest.raises(ConfigError, match=words):
        check_spec(str(tmp_path / "tone.wav"), "audio")


def test_sound_of_a_few_samples_is_not_opened_over_and_over(tmp_path, monkeypatch):
    write_tone(tmp_path / "tone.wav", seconds=0.001)
    clock = ManualClock(0)
    source = open_audio(str(tmp_path / "tone.wav"), name="mic", clock=clock)
    opened, before = [], av.open
    monkeypatch.setattr(av, "open", lambda *args, **rest: opened.append(0) or before(*args, **rest))
    while clock.now_ns() < NS_PER_S:
        source.read(20 * NS_PER_MS)
    # Each try opens it for its times and for its samples.
    assert len(opened) <= 2 * (1 + NS_PER_S // RETRY_NS)
