"""Samples run as a user runs them, and every sample has a test."""

import re
import shutil
import subprocess
import sys

import av
import cv2
import numpy as np
import pytest
from positions import ROOT
from synthetic_recording import BEGIN_NS, LINK_NS, MS, PUBLISHED_NS, TOUCH_S, S, write_recording

from kontur_av.media import empty_picture
from kontur_av.topics.session_files import shared_memory
from telepresence import WorldState, render

SAMPLES = ROOT / "samples"
TESTS = ROOT / "tests"


def run(name, *arguments):
    command = [sys.executable, str(SAMPLES / name), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120)


@pytest.mark.parametrize("sample", sorted(path.name for path in SAMPLES.glob("*.py")))
def test_each_sample_has_a_test(sample):
    texts = [path.read_text() for path in TESTS.rglob("test_*.py")]
    assert any(f'"{sample}"' in text for text in texts), f"no test runs samples/{sample}"


def test_publish_topic():
    command = [sys.executable, str(SAMPLES / "publish_topic.py")]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    process = subprocess.Popen(command, **pipes)
    out, error = process.communicate(timeout=60)
    assert (process.returncode, error) == (0, "")
    pictures = re.search(r"^(\d+) pictures of 460800 octets, (\d+) us old", out, re.MULTILINE)
    assert 1 <= int(pictures[1]) <= 60
    for number, brightness in re.findall(r"picture (\d+): brightness (\d+)", out):
        assert int(brightness) == int(number) + 16
    assert shared_memory(f"sample-{process.pid}") == []
    done = run("bench_latency.py", "--clip", "nosuch.mp4")
    assert done.returncode != 0
    assert len(done.stderr.splitlines()) == 1
    assert "nosuch.mp4" in done.stderr


def test_bench_latency_on_a_film(footage):
    film = footage("carphone_pristine.mp4")
    done = run("bench_latency.py", "--clip", film, "--seconds", 2, "--cap-kbps", 85)
    assert done.returncode == 0, done.stderr
    rows = {line[:20].strip(): line[20:].split() for line in done.stdout.splitlines()[1:6]}
    assert list(rows) == ["encode", "cap and channel", "network", "decode", "capture to decoded"]
    for values in rows.values():
        p50, p95, p99, largest = map(float, values)
        assert 0 <= p50 <= p95 <= p99 <= largest
    assert float(rows["capture to decoded"][3]) > 0
    counts = re.search(
        r"(\d+) pictures sent, (\d+) seen, (\d+) packets lost, ([\d.]+) of 85", done.stdout
    )
    sent, seen, lost = (int(counts[index]) for index in (1, 2, 3))
    assert 0 < seen <= sent
    assert lost == 0
    assert 0 < float(counts[4]) <= 85


@pytest.mark.skipif(shutil.which("espeak-ng") is None, reason="apt-get install espeak-ng")
def test_make_speech(tmp_path):
    done = run("make_speech.py", tmp_path)
    assert done.returncode == 0, done.stderr
    for name in ("speech_ground.flac", "speech_cabin.flac"):
        with av.open(str(tmp_path / name)) as file:
            samples = np.concatenate([f.to_ndarray().ravel() for f in file.decode(audio=0)])
            rate_hz = file.streams.audio[0].rate
        assert rate_hz == 16_000
        assert 2 < len(samples) / rate_hz < 30
        assert 8_000 < np.abs(samples).max() <= 16_384


def test_merge_stereo(tmp_path):
    paths = [tmp_path / f"{name}.png" for name in ("left", "right", "merged")]
    for path in paths[:2]:
        picture = empty_picture(640, 480)
        render(path.stem, WorldState(time_ns=0, x_m=0.0, y_m=-0.02), picture)
        cv2.imwrite(str(path), cv2.cvtColor(picture, cv2.COLOR_YUV2BGR_I420))
    assert run("merge_stereo.py", *paths).returncode == 0
    left, right, merged = (cv2.imread(str(path)).astype(int) for path in paths)
    # The stylus in the middle is whole from one camera, so the seam is beside it. The conversions
    # interpolate chroma, so the columns at the seam are left out.
    (seams,) = np.nonzero((np.abs(merged - left) > 20).any(axis=(0, 2)))
    seam = seams[0]
    assert 64 < abs(seam - 320) < 320
    assert np.abs(merged[:, : seam - 4] - left[:, : seam - 4]).mean() < 2
    assert np.abs(merged[:, seam + 4 :] - right[:, seam + 4 :]).mean() < 2
    assert run("merge_stereo.py", tmp_path / "none.png", *paths[1:]).returncode == 1


def test_plot_contacts(tmp_path):
    recording = write_recording(tmp_path / "a.mcap", parts=2)
    picture = tmp_path / "contacts.png"
    done = run("plot_contacts.py", *recording.paths, "--picture", picture)
    assert (done.returncode, done.stderr) == (0, "")
    rows = [[float(word) for word in line.split()] for line in done.stdout.splitlines()[1:]]
    begins = [(first - BEGIN_NS) / S for first, _ in recording.contacts]
    assert [row[1] for row in rows] == [round(begin, 2) for begin in begins]
    for _, _, length_s, most_n, late_ms in rows:
        assert round(length_s, 2) == TOUCH_S
        assert round(most_n, 1) == 3.0
        assert late_ms == (LINK_NS + PUBLISHED_NS) / MS
    assert cv2.imread(str(picture)).shape == (900, 1200, 3)
    (path,) = write_recording(tmp_path / "torn.mcap", end=False).paths
    done = run("plot_contacts.py", path)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert "torn.mcap is no whole recording" in done.stderr


def test_plot_pass(tmp_path):
    picture = tmp_path / "pass.png"
    done = run("plot_pass.py", "--seconds", 120, "--picture", picture)
    lines = done.stdout.splitlines()
    assert lines[0].startswith("acquisition: 2015-08-18T14:32")
    first, second = (line.split() for line in lines[-2:])
    # In the first minute the signal comes and goes, in the second it stays.
    assert 10 < float(first[-4]) < 90
    assert float(second[-4]) < 1
    assert cv2.imread(str(picture)).shape == (900, 1200, 3)
    (tmp_path / "mine.toml").write_text('[contact]\nelements = "iss.tle"\n')
    done = run("plot_pass.py", "--radio", tmp_path / "mine.toml")
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert "iss.tle" in done.stderr


def test_plot_repair(tmp_path):
    picture = tmp_path / "repair.png"
    done = run("plot_repair.py", "--seconds", 2, "--loss", 0.02, "--picture", picture)
    own = [line for line in done.stdout.splitlines() if not line.startswith("GStreamer")]
    shares = [float(line.split()[-1]) for line in own]
    # In the order of the curves: nothing, idle slots, and what is left out for them.
    assert shares[0] < shares[1] <= shares[2] <= 100
    assert cv2.imread(str(picture)).shape == (600, 1050, 3)


def test_slots_virtual_time_and_mediated_wall(tmp_path):
    lines = run("slots_virtual_time.py", 3).stdout.splitlines()
    assert lines[0] == "haptic samples received: 3000 in 3000 slots"
    rows = {line.split()[0]: line.split() for line in lines[2:6]}
    assert set(rows) == {"video", "voice", "telecommands", "file"}
    assert float(rows["telecommands"][3]) <= 3
    assert float(rows["voice"][3]) <= 4
    assert float(rows["video"][2]) > 29
    picture = tmp_path / "felt.png"
    done = run("mediated_wall.py", "--delays", 300, "--picture", picture)
    rows = [line.split() for line in done.stdout.splitlines()[1:]]
    felt = {(row[2], row[3]): float(row[6]) for row in rows}
    for grip in ("soft", "firm"):
        assert felt[grip, "mediated"] > 2 * felt[grip, "direct"]
    assert cv2.imread(str(picture)).shape == (400, 700, 3)
