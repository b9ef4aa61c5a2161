"""Sound that is played by a real `aplay`, into ALSA's file plug-in."""

import json
import shutil
import subprocess
import sys

import numpy as np
import pytest
from alsa_file import make_alsa_file
from common import eventually, free_port

from kontur_av import ConfigError, MonotonicClock, SoundSender
from kontur_av.streams.loudspeaker import BUFFER_NS, Loudspeaker

TONE = (np.sin(np.arange(960) * 2 * np.pi / 48) * 9_000).astype(np.int16)


@pytest.fixture
def played(tmp_path, monkeypatch):
    if shutil.which("aplay") is None:
        pytest.skip("aplay: apt-get install alsa-utils")
    make_alsa_file(tmp_path, monkeypatch, played=tmp_path / "out.raw")
    return tmp_path / "out.raw"


def heard(file):
    return np.fromfile(file, "<i2") if file.exists() else np.empty(0, np.int16)


def test_blocks_are_played_whole_and_in_order(played):
    clock = MonotonicClock()
    blocks = [np.full(960, number + 1, np.int16) for number in range(40)]
    given = []
    with Loudspeaker("alsa:played", clock) as speaker:
        for block in blocks:
            delay_ns = speaker.play(block)
            if delay_ns is not None:
                given.append(block)
                # Never more than the buffer and a page of the pipe.
                assert 0 <= delay_ns <= BUFFER_NS + 4096 * 10**9 // 96_000
            clock.sleep_until_ns(clock.now_ns() + 20_000_000)
    assert given and (speaker.played, speaker.play_faults) == (len(given), 0)
    assert speaker.played + speaker.play_dropped == len(blocks)
    sound = np.concatenate(given)
    assert (heard(played)[: len(sound)] == sound).all()


def test_a_device_that_is_not_there_is_tried_again_and_never_waited_for(played):
    clock = MonotonicClock()
    with Loudspeaker("alsa:nosuch", clock) as speaker:
        eventually(lambda: speaker.play(TONE) is None and speaker.play_faults > 1, "another try")
    assert "No such" in speaker.play_fault
    for spec in ("alsa:", "jack:x", "", "tone"):
        with pytest.raises(ConfigError, match=r"loudspeaker .*: write default, alsa:DEVICE or"):
            Loudspeaker(spec, clock)


def test_receive_plays_a_stream_and_reports_the_delay_of_the_player(played, tmp_path):
    sdp, report = tmp_path / "s.sdp", tmp_path / "r.json"
    with SoundSender(f"127.0.0.1:{free_port(more=1)}", cap_bps=64_000, sdp=sdp) as end:
        end.send(TONE)
        words = ["receive", "--sdp", str(sdp), "--play", "alsa:played", "--report", str(report)]
        command = [sys.executable, "-m", "pipelines.cli", *words, "--seconds", "4"]
        receiver = subprocess.Popen(command)
        while receiver.poll() is None:
            end.send(TONE)
    assert receiver.returncode == 0
    told = json.loads(report.read_text())["played"]
    assert told["played"] > 20 and told["play_faults"] == 0
    assert told["delay_ms"]["max"] <= 83
    assert np.abs(heard(played)).max() > 5_000
