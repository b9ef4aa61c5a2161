"""Live sources in real time: FIFOs with real writers, a camera thread, a real ALSA device."""

import itertools
import os
import shutil
import subprocess
import threading
import time

import numpy as np
import pytest
from alsa_file import make_alsa_file
from common import eventually

from kontur_av.clock import NS_PER_MS, NS_PER_S, ManualClock, MonotonicClock
from kontur_av.media import empty_picture, planes
from kontur_av.sources import check_spec, open_audio, open_video
from kontur_av.sources.camera import CameraVideo
from kontur_av.sources.microphone import MicrophoneAudio
from pipelines.cli import main

CLOCK = MonotonicClock()
SIZE = (64, 48)
#: Protects against a hang; no result of a test depends on it.
TIMEOUT_NS = 60 * NS_PER_S


def y4m_header(width, height, colour="420jpeg", rate="30:1"):
    return b"YUV4MPEG2 W%d H%d F%s Ip A1:1 C%s\n" % (
        width, height, rate.encode(), colour.encode()
    )  # fmt: skip


def y4m_picture(width, height, level):
    return b"FRAME\n" + bytes([level]) * (width * height) + bytes([128]) * (width * height // 2)


@pytest.fixture
def fifo(tmp_path):
    path = tmp_path / "live.y4m"
    os.mkfifo(path)
    return path


class CountedClock(MonotonicClock):
    """Counts how often it is asked: a source asks it each time that it wakes up."""

    asked = 0

    def now_ns(self):
        self.asked += 1
        return super().now_ns()


def opened(path, size=SIZE, fps=30, clock=CLOCK):
    return open_video(f"pipe:{path}", name="head", width=size[0], height=size[1], fps=fps,
                        clock=clock)  # fmt: skip


def levels(source, count, size=SIZE, timeout_ns=TIMEOUT_NS):
    picture, result = empty_picture(*size), []
    for _ in range(count):
        stamp = source.read(picture, timeout_ns)
        result.append(None if stamp is None else round(float(planes(picture)[0].mean())))
    return result


def write_later(path, chunks, pause_s=0.035):
    def run():
        with path.open("wb", buffering=0) as pipe:
            for chunk in chunks:
                pipe.write(chunk)
                time.sleep(pause_s)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    return thread


def test_the_writer_leaves_and_returns_with_another_size(fifo):
    clock = CountedClock()
    source = opened(fifo, clock=clock)
    assert source.read(empty_picture(*SIZE), 200 * NS_PER_MS) is None
    assert clock.asked < 20 and source.faults == 0
    first = write_later(
        fifo, [y4m_header(*SIZE), y4m_picture(*SIZE, 60), y4m_picture(*SIZE, 61)[:99]]
    )
    assert levels(source, 1) == [60]
    first.join()
    clock.asked = 0
    assert source.read(empty_picture(*SIZE), 200 * NS_PER_MS) is None
    assert clock.asked < 20
    assert "writer has gone" in source.last_fault
    second = write_later(fifo, [y4m_header(128, 48), y4m_picture(128, 48, 200)])
    picture = empty_picture(*SIZE)
    assert source.read(picture, TIMEOUT_NS).sequence == 1
    assert (planes(picture)[0][:12] == 16).all()
    assert abs(int(planes(picture)[0][24, 32]) - 200) < 3
    second.join()
    source.close()
    source.close()


@pytest.mark.parametrize("used_before", [True, False])
def test_a_fifo_that_was_removed_and_made_again_is_read(fifo, used_before):
    source = opened(fifo)
    if used_before:
        first = write_later(fifo, [y4m_header(*SIZE), y4m_picture(*SIZE, 60)])
        assert levels(source, 1) == [60]
        fifo.unlink()
        first.join()
    else:
        fifo.unlink()
    assert levels(source, 1, timeout_ns=200 * NS_PER_MS) == [None]
    os.mkfifo(fifo)
    second = write_later(fifo, [y4m_header(*SIZE), y4m_picture(*SIZE, 200)])
    eventually(lambda: levels(source, 1, timeout_ns=300 * NS_PER_MS) == [200], "a picture")
    second.join()
    source.close()


@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="ffmpeg: apt-get install ffmpeg")
@pytest.mark.interop
def test_pictures_piped_by_ffmpeg_are_shown(fifo):
    source = opened(fifo, (160, 120))
    command = ["ffmpeg", "-v", "error", "-re", "-f", "lavfi", "-i", "testsrc=size=320x240:rate=30"]
    writer = subprocess.Popen(
        [*command, "-t", "10", "-pix_fmt", "yuv420p", "-f", "yuv4mpegpipe", "-y", fifo]
    )
    seen = levels(source, 25, (160, 120))
    assert None not in seen
    assert source.faults == 0
    writer.kill()
    writer.wait()


def test_a_camera_gives_its_newest_picture_and_ends_in_time(monkeypatch):
    # A build machine has no camera, so FFmpeg's test picture takes the same path.
    monkeypatch.setattr(CameraVideo, "_demuxer", "lavfi")
    picture = "testsrc=size=128x48:rate=30,realtime"
    camera = CameraVideo("head", 64, 48, 30, CLOCK, picture)
    picture = empty_picture(*SIZE)
    stamps = [camera.read(picture, TIMEOUT_NS) for _ in range(5)]
    assert [s.sequence for s in stamps] == list(range(5))
    assert all(a.capture_ns < b.capture_ns for a, b in itertools.pairwise(stamps))
    assert (planes(picture)[0][:12] == 16).all()
    assert planes(picture)[0][16:32].std() > 10
    camera.close()


@pytest.fixture
def alsa_file(tmp_path, monkeypatch):
    if shutil.which("arecord") is None:
        pytest.skip("arecord: apt-get install alsa-utils")
    t = np.arange(48_000 * 20)
    (tmp_path / "in.raw").write_bytes((np.sin(t / 20) * 9_000).astype("<i2").tobytes())
    make_alsa_file(tmp_path, monkeypatch, recorded=tmp_path / "in.raw")
    return "alsa:played"


def test_a_microphone_gives_blocks_of_20_ms(alsa_file):
    check_spec(alsa_file, "audio")
    source = open_audio(alsa_file, name="ground_mic", clock=CLOCK)
    blocks = [source.read(TIMEOUT_NS) for _ in range(10)]
    assert {b.samples.shape for b in blocks} == {(960,)}
    assert [b.stamp.sequence for b in blocks] == list(range(10))
    assert max(np.abs(b.samples).max() for b in blocks) > 8_000
    source.close()


def test_a_microphone_that_disappears_is_opened_again(alsa_file):
    source = open_audio(alsa_file, name="ground_mic", clock=CLOCK)
    assert source.read(TIMEOUT_NS) is not None
    source._process.kill()
    eventually(lambda: source.read(100 * NS_PER_MS) is None and source.faults, "the fault")
    assert source.faults == 1
    eventually(lambda: source.read(100 * NS_PER_MS), "sound again")
    source.close()


#: More than the 64 KiB that a pipe holds, before the sound, and a last message after it.
TALKATIVE = """#!/bin/sh
case "$*" in *" -s 1") exit 0;; esac
head -c 200000 /dev/zero | tr '\\0' x >&2
echo >&2
head -c 19200 /dev/zero
echo "arecord: pcm_read:2221: read error: No such device" >&2
"""


@pytest.fixture
def recorder(tmp_path, monkeypatch):
    def install(script):
        program = tmp_path / "arecord"
        program.write_text(script)
        program.chmod(0o755)
        monkeypatch.setattr("shutil.which", lambda name: str(program))

    return install


def test_messages_of_the_recorder_never_stop_the_sound(recorder):
    recorder(TALKATIVE)
    source = MicrophoneAudio("ground_mic", CLOCK, "default")
    blocks = []
    for _ in range(200):
        block = source.read(50 * NS_PER_MS)
        if block is not None:
            blocks.append(block)
        if source.faults:
            break
    source.close()
    assert blocks
    assert source.last_fault == "default: No such device"


def test_a_device_without_a_clock_is_held_to_real_time(recorder):
    recorder("#!/bin/sh\nexec head -c 40000000 /dev/zero\n")
    clock = ManualClock(0)
    source = MicrophoneAudio("ground_mic", clock, "null")
    heard = sum(source.read(NS_PER_S) is not None for _ in range(200))
    source.close()
    assert heard == 200
    assert clock.now_ns() > 3.8 * NS_PER_S


def test_a_session_with_a_missing_microphone_is_refused_before_it_starts(capsys):
    assert (
        main(["stream", "--setup", "spacejustin", "--source", "operator_mic=alsa:nosuchcard"]) == 2
    )
    (line,) = capsys.readouterr().err.splitlines()
    assert "nosuchcard" in line
