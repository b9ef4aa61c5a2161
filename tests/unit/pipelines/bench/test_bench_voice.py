"""`kontur-av bench voice`: reproducible figures, and the parts that they come from."""

import json

import cv2
import numpy as np
import pytest

from pipelines.bench.voice import command as voice
from pipelines.bench.voice.gstreamer import laid_out
from pipelines.bench.voice.network import BURST_PACKETS, Network
from pipelines.bench.voice.speech import LEAD_IN_BLOCKS, lags, speech_track
from pipelines.bench.voice.virtual import listen, speak
from pipelines.cli import main
from pipelines.setup.built_in import BUILT_IN

SETUP = BUILT_IN["spacejustin"]


def test_loss_share_and_burst_length_are_as_configured():
    for loss in (0.02, 0.1):
        assert len(Network(loss=loss).lost(20_000, spared=50)) / 20_000 == pytest.approx(
            loss, rel=0.15
        )
        lost = Network(loss=loss, bursts=True).lost(60_000, spared=50)
        assert len(lost) / 60_000 == pytest.approx(loss, rel=0.15)
        bursts = sum(number - 1 not in lost for number in lost)
        assert len(lost) / bursts == pytest.approx(BURST_PACKETS, rel=0.15)
        assert min(lost) >= 50
    assert Network(loss=0.0).lost(1000, spared=0) == frozenset()


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


def test_a_lag_is_found_although_the_speakers_repeat_themselves():
    track = speech_track(40)
    for late in (-700, 0, 9_000):
        # The second of the two rounds is the louder one.
        heard = np.roll(track.samples, late) // 2
        heard[len(heard) // 2 :] *= 2
        assert set(lags(track, heard)[2:-2]) == {late}


def test_the_sound_of_a_peer_is_laid_out_as_a_sound_card_plays_it():
    """Packets follow each other although their timestamps wobble; a hole of more than 40 ms is one.

    GstAudioBaseSink, `alignment-threshold`: 40 ms.
    """
    first = 2**32 - 500  # the timestamps go round
    block = np.arange(1, 961, dtype=np.int16)

    def arrivals(*timestamps):
        return [
            (10 * i, (first + timestamp) % 2**32, block) for i, timestamp in enumerate(timestamps)
        ]

    sound, places = laid_out(arrivals(0, 960 + 1900, 1920 - 900))
    assert np.array_equal(sound, np.tile(block, 3))
    assert places == [(0, 0), (10, 960), (20, 1920)]
    sound, places = laid_out(arrivals(0, 960 + 1921, 1920 + 1921))
    assert np.array_equal(sound, np.concatenate([block, np.zeros(1921, np.int16), block, block]))
    assert places == [(0, 0), (10, 2881), (20, 3841)]


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


def test_the_command_writes_its_figures(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(voice, "_LOSSES", (0.0, 0.1))
    report, plot = tmp_path / "v.json", tmp_path / "v.png"
    options = ["--seconds", "1", "--no-live", "--report", str(report), "--plot", str(plot)]
    assert main(["bench", "voice", *options]) == 0
    figures = json.loads(report.read_text())["voice"]
    assert set(figures) == {"8 kbit/s", "64 kbit/s"}
    assert all(len(rows) == 3 for rows in figures.values())
    for row in (row for rows in figures.values() for row in rows):
        assert row["mouth_to_ear_ms"]["p99"] <= 60
        assert (row["pesq"] is not None) == voice.pesq_is_there()
    assert "no GStreamer: left out by --no-live" in capsys.readouterr().out
    assert cv2.imread(str(plot)).shape[1] == 1200


def test_a_missing_peer_or_pesq_is_one_line(monkeypatch, capsys):
    monkeypatch.setattr(voice, "pesq_is_there", lambda: False)
    monkeypatch.setattr(voice, "missing", lambda: "it is not installed")
    monkeypatch.setattr(voice, "_LOSSES", (0.0, 0.1))
    assert main(["bench", "voice", "--seconds", "1"]) == 0
    out = capsys.readouterr().out
    assert "no quality: PESQ is missing (pip install 'kontur-av[bench]')" in out
    assert "no GStreamer: it is not installed" in out


@pytest.mark.parametrize(
    "wrong",
    [["--seconds", "0"], ["--jitter-ms", "21"], ["--delay-ms", "-1"], ["--plot", "x.jpg"]],
)
def test_impossible_options_are_refused(wrong, capsys):
    assert main(["bench", "voice", *wrong]) == 2
    assert wrong[0] in capsys.readouterr().err
