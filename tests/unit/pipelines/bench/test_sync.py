"""`kontur-av bench sync` on recordings that are made with known offsets."""

import json
from fractions import Fraction

import av
import numpy as np
import pytest
from common import write_sound

from kontur_av.errors import ConfigError
from pipelines.bench.sync import clicks, lights, steps
from pipelines.cli import main

FPS, SECONDS = 30, 7.5
#: Instants of the touches (s), and the delays of light and sound after force.
TOUCHES = (1.213, 3.377, 5.104, 6.651)
LIGHT_S, CLICK_S = 0.045, 0.020
SIZE = (320, 240)
PERIOD_MS = 1000 / FPS


def pictures():
    """A grey room, a moving object, and an LED of 9 pixels that is on for 0.7 s."""
    width, height = SIZE
    rng = np.random.default_rng(1)
    room = rng.integers(70, 110, (height, width, 1), np.uint8).repeat(3, 2)
    for number in range(int(SECONDS * FPS)):
        t = number / FPS
        picture = room.copy()
        at = int(40 + 120 * (t / SECONDS))
        picture[150:220, at : at + 25] = (150, 140, 130)
        lit = any(touch + LIGHT_S <= t < touch + LIGHT_S + 0.7 for touch in TOUCHES)
        picture[60:69, 200:209] = (255, 90, 70) if lit else (60, 20, 20)
        yield picture


def sound():
    """Hiss and hum, and a click of two damped tones."""
    n = int(SECONDS * 48_000)
    t = np.arange(n) / 48_000
    heard = np.random.default_rng(2).normal(0, 40, n) + 900 * np.sin(2 * np.pi * 180 * t)
    for touch in TOUCHES:
        begin = round((touch + CLICK_S) * 48_000)
        k = np.arange(1000) / 48_000
        heard[begin : begin + 1000] += 9000 * np.exp(-k / 0.004) * np.sin(2 * np.pi * 2400 * k)
    return heard.clip(-32768, 32767).astype(np.int16)


def film(path, codec, shown, size=SIZE, *, heard=None, **options):
    """Write pictures, and sound beside them."""
    with av.open(str(path), "w") as file:
        video = file.add_stream(codec, rate=FPS, options=options)
        video.width, video.height = size
        video.pix_fmt = "yuv420p"
        audio = heard is not None and file.add_stream("aac", rate=48_000, layout="mono")
        for picture in shown:
            frame = av.VideoFrame.from_ndarray(picture, "rgb24").reformat(format="yuv420p")
            file.mux(video.encode(frame))
        if audio:
            frame = av.AudioFrame.from_ndarray(heard[None], "s16", "mono")
            frame.sample_rate, frame.pts, frame.time_base = 48_000, 0, Fraction(1, 48_000)
            file.mux([*audio.encode(frame), *audio.encode(None)])
        file.mux(video.encode(None))


@pytest.fixture(scope="module")
def clips(tmp_path_factory):
    folder = tmp_path_factory.mktemp("clips")
    film(folder / "both.mp4", "libx264", pictures(), heard=sound(), crf="28", preset="fast")
    film(folder / "see.y4m", "wrapped_avframe", pictures())
    write_sound(folder / "hear.wav", sound())
    rows = ["time_s,force_n"]
    for number in range(int(SECONDS * 1000)):
        t = number / 1000
        depth = sum(max(0.0, min(t - touch, 0.01)) for touch in TOUCHES if t < touch + 0.8)
        rows.append(f"{t:.3f},{depth * 200 + 0.004 * (-1) ** number:.4f}")
    (folder / "felt.csv").write_text("\n".join(rows) + "\n")
    return folder


def bench(path, *words):
    """The skews of `kontur-av bench sync` with these recordings."""
    assert main(["bench", "sync", *map(str, words), "--report", str(path)]) == 0
    return json.loads(path.read_text())


def test_the_known_skews_are_found(clips, tmp_path, capsys):
    plot = tmp_path / "p.png"
    both, felt = clips / "both.mp4", clips / "felt.csv"
    words = ["--video", both, "--audio", both, "--haptics", felt]
    metrics = bench(tmp_path / "r.json", *words, "--plot", plot)
    assert len(metrics["events"]) == len(TOUCHES)
    for event, touch in zip(metrics["events"], TOUCHES, strict=True):
        assert event["force"] == pytest.approx(touch, abs=0.002)
        assert 0 <= event["light"] - touch - LIGHT_S < 1 / FPS + 0.001
        assert event["click"] == pytest.approx(touch + CLICK_S, abs=0.001)
    skews = metrics["skew_ms"]
    assert skews["audio_haptic"]["p50"] == pytest.approx(1000 * CLICK_S, abs=2)
    assert 1000 * LIGHT_S - 2 <= skews["video_haptic"]["p50"] <= 1000 * LIGHT_S + PERIOD_MS
    # 20 ms of 24; 45 of 15.
    names = ("audio_haptic", "video_haptic", "audio_video")
    assert [skews[name]["within"] for name in names] == [1.0, 0.0, 1.0]
    assert "Di Luca and Mahnan" in capsys.readouterr().out
    assert plot.stat().st_size > 1000


def test_an_offset_moves_one_recording_and_lights_outside_the_region_are_ignored(
    clips, tmp_path, capsys
):
    words = ["--audio", clips / "hear.wav", "--haptics", clips / "felt.csv"]
    skews = bench(tmp_path / "r.json", *words, "--offset-ms", "audio=-20")["skew_ms"]
    assert skews["audio_haptic"]["p50"] == pytest.approx(0, abs=2)
    assert skews["video_haptic"] is None
    both = clips / "both.mp4"
    skew = bench(tmp_path / "r.json", "--video", both, "--audio", both)["skew_ms"]["audio_video"]
    assert skew["events"] == len(TOUCHES)
    early_ms = 1000 * (CLICK_S - LIGHT_S)
    assert early_ms - PERIOD_MS - 1 <= skew["p50"] <= early_ms + 1
    arguments = ["--video", str(clips / "both.mp4"), "--haptics", str(clips / "felt.csv")]
    assert main(["bench", "sync", *arguments, "--roi", "180,40,48,48"]) == 0
    assert main(["bench", "sync", *arguments, "--roi", "0,160,48,48"]) == 2
    assert main(["bench", "sync", *arguments, "--roi", "300,40,48,48"]) == 2
    error = capsys.readouterr().err
    assert "no light" in error
    assert "320x240" in error


@pytest.mark.parametrize(
    ("read", "name", "content", "words"),
    [
        (lights, "none.mp4", None, "no such file"),
        (clicks, "text.wav", b"RIFF", "not a media file"),
        (steps, "empty.csv", b"", "begin with the heading time_s,force_n"),
        (steps, "words.csv", b"time_s,force_n\n0,1\n0.1,hard\n", "line 3: give two numbers"),
        (steps, "nan.csv", b"time_s,force_n\n0,1\n0.1,nan\n", "line 3"),
        (steps, "gap.csv", b"time_s,force_n\n0.1,1\n\n0,1\n", "4: time does not increase after"),
        (steps, "short.csv", b"time_s,force_n\n0,1\n", "fewer than 2 rows"),
        (steps, "octets.csv", b"\xff\xfe\x00", "no table of text"),
    ],
)
def test_an_unreadable_file_is_named(tmp_path, read, name, content, words):
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ConfigError, match=words) as caught:
        read(path, *((None,) if read is lights else ()))
    assert "\n" not in str(caught.value) and name in str(caught.value)
    # A table from a spreadsheet is read.
    path = tmp_path / "felt.csv"
    path.write_text("\ufefftime_s,force_n\n0,1e200\n\n0.1,3\n0.2,3\n0.3,8\n", encoding="utf-8")
    assert [step.instant_ns for step in steps(path)] == [300_000_000]
