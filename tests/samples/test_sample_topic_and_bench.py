"""Samples run as a user runs them, and every sample has a test."""

import re
import shutil
import subprocess
import sys

import av
import numpy as np
import pytest
from places import ROOT

from kontur_av.topics.session_files import shared_memory

SAMPLES = ROOT / "samples"
TESTS = ROOT / "tests"


def run(name, *arguments):
    command = [sys.executable, str(SAMPLES / name), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=60)


@pytest.mark.parametrize("sample", sorted(path.name for path in SAMPLES.glob("*.py")))
def test_each_sample_has_a_test(sample):
    texts = [path.read_text() for path in TESTS.rglob("test_*.py")]
    assert any(f'"{sample}"' in text for text in texts), f"no test runs samples/{sample}"


def test_publish_topic():
    process = subprocess.Popen(
        [sys.executable, str(SAMPLES / "publish_topic.py")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    out, error = process.communicate(timeout=60)
    assert (process.returncode, error) == (0, "")
    pictures = re.search(r"^(\d+) pictures of 460800 octets, (\d+) us old", out, re.MULTILINE)
    assert 1 <= int(pictures[1]) <= 60
    for number, brightness in re.findall(r"picture (\d+): brightness (\d+)", out):
        assert int(brightness) == int(number) + 16
    assert shared_memory(f"sample-{process.pid}") == []


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


def test_bench_latency_refuses_in_one_line():
    done = run("bench_latency.py", "--clip", "nosuch.mp4")
    assert done.returncode != 0
    assert len(done.stderr.splitlines()) == 1
    assert "nosuch.mp4" in done.stderr


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
