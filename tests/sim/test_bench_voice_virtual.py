"""`benchmarks voice`: voices on virtual time, and the command that prints their figures."""

import json

import cv2
import numpy as np
import pytest

from benchmarks.__main__ import main
from benchmarks.voice import command as voice
from benchmarks.voice.network import Network
from benchmarks.voice.speech import LEAD_IN_BLOCKS, lags, speech_track
from benchmarks.voice.virtual import listen, speak
from pipelines.session.setup.setup_file import BUILT_IN

SETUP = BUILT_IN["spacejustin"]


@pytest.fixture(scope="module")
def track():
    return speech_track(1)


@pytest.mark.parametrize("stream", [SETUP.uplink_voice, SETUP.downlink_voice])
def test_stamps_agree_with_the_lag_of_the_sound(track, stream):
    """Mouth to ear by stamps equals the lag of the sound that is heard."""
    heard = listen(SETUP, stream, speak(SETUP, stream, track), Network(loss=0.0))
    found = lags(track, heard.samples)[LEAD_IN_BLOCKS // 50 + 1 : -2]
    # 0.3 ms: the phase of the filters of Opus.
    assert max(abs(lag - heard.lag_samples) for lag in found) <= 15
    worst_ms = max(heard.mouth_to_ear_ns) / 1e6
    # 20 of the block, 6.5 of look-ahead, 1.5 of coding, 5 to 10 of the network, 10 of playout.
    assert 38 < worst_ms <= 60
    assert heard.payload_octets * 8 / (heard.packets * 0.02) <= stream.cap_bps


def test_a_lossy_run_is_reproducible_and_complete(track):
    network = Network(loss=0.1, bursts=True)
    stream = SETUP.uplink_voice
    first, again = (listen(SETUP, stream, speak(SETUP, stream, track), network) for _ in range(2))
    assert np.array_equal(first.samples, again.samples)
    assert first.mouth_to_ear_ns == again.mouth_to_ear_ns
    clean = listen(SETUP, stream, speak(SETUP, stream, track), Network(loss=0.0))
    assert abs(len(first.samples) - len(clean.samples)) <= 960
    # At most 100 ms of a row of losses are concealed.
    assert 0.7 * first.lost * 20e6 <= first.made_up_ns <= (first.lost + 5) * 20e6


def test_the_command_writes_its_metrics(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(voice, "_LOSSES", (0.0, 0.1))
    report, plot = tmp_path / "v.json", tmp_path / "v.png"
    options = ["--seconds", "1", "--no-live", "--report", str(report), "--plot", str(plot)]
    assert main(["voice", *options]) == 0
    metrics = json.loads(report.read_text())["voice"]
    assert set(metrics) == {"8 kbit/s", "64 kbit/s"}
    assert all(len(rows) == 3 for rows in metrics.values())
    for row in (row for rows in metrics.values() for row in rows):
        assert row["mouth_to_ear_ms"]["p99"] <= 60
        assert (row["pesq"] is not None) == voice.pesq_is_there()
    assert "no GStreamer: left out by --no-live" in capsys.readouterr().out
    assert cv2.imread(str(plot)).shape[1] == 1200


def test_a_missing_peer_or_pesq_is_one_line(monkeypatch, capsys):
    monkeypatch.setattr(voice, "pesq_is_there", lambda: False)
    monkeypatch.setattr(voice, "missing", lambda: "it is not installed")
    monkeypatch.setattr(voice, "_LOSSES", (0.0, 0.1))
    assert main(["voice", "--seconds", "1"]) == 0
    out = capsys.readouterr().out
    assert "no quality: PESQ is missing (pip install 'kontur-av[bench]')" in out
    assert "no GStreamer: it is not installed" in out
