"""`send` and `receive` refuse the user's mistakes in one line, before anything starts."""

import argparse
import socket
import wave

import pytest

from kontur_av.errors import ConfigError
from pipelines.commands import receive, send

SDP = "v=0\nc=IN IP4 127.0.0.1\nm=audio {port} RTP/AVP 97\na=rtpmap:97 opus/48000/2\n"
GOOD = ["--audio", "tone.wav", "--to", "127.0.0.1:5004", "--cap-kbps", "64"]


def run(command, *options) -> int:
    parser = argparse.ArgumentParser()
    command.add_arguments(parser)
    return command.run(parser.parse_args([str(option) for option in options]))


@pytest.mark.parametrize(
    ("options", "mend"),
    [
        (["--audio", "missing.wav"], "missing.wav"),
        (["--audio", "page"], "only a session has pages"),
        (["--to", "127.0.0.1"], "HOST:PORT"),
        (["--to", "127.0.0.1:99999"], "65534"),
        (["--to", "no.such.host.invalid:5004"], "no.such.host"),
        (["--cap-kbps", "-3"], "above 0"),
        (["--cap-kbps", "6"], "a cap of 6 kbit/s: .* 6.24 to"),
        (["--cap-kbps", "64", "--channel-kbps", "60"], "lower the cap"),
        (["--seconds", "0"], "above 0"),
        (["--sdp", "/nowhere/x.sdp"], "--sdp"),
        (["--report", "/nowhere/x.json"], "--report"),
    ],
)
def test_send_refuses(options, mend, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with wave.open("tone.wav", "wb") as file:
        file.setparams((1, 2, 48_000, 0, "NONE", ""))
        file.writeframes(bytes(96_000))
    with pytest.raises(ConfigError, match=mend) as refused:
        run(send, *GOOD, *options)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("size", "mend"), [("640", "WIDTHxHEIGHT"), ("641x480", "even"), ("axb", "WIDTHxHEIGHT")]
)
def test_send_refuses_a_size(size, mend):
    with pytest.raises(ConfigError, match=mend):
        run(send, "--video", "x.mp4", *GOOD[2:], "--size", size)


def test_receive_refuses(tmp_path):
    with pytest.raises(ConfigError, match="cannot be read"):
        run(receive, "--sdp", tmp_path / "none.sdp")
    sdp = tmp_path / "x.sdp"
    sdp.write_text("hello")
    with pytest.raises(ConfigError, match="no SDP"):
        run(receive, "--sdp", sdp)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as busy:
        busy.bind(("127.0.0.1", 0))
        port = busy.getsockname()[1]
        sdp.write_text(SDP.format(port=port))
        with pytest.raises(ConfigError, match="cannot be opened"):
            run(receive, "--sdp", sdp)
    sdp.write_text(SDP.format(port=port))
    with pytest.raises(ConfigError, match="--save"):
        run(receive, "--sdp", sdp, "--seconds", 1, "--save", "/nowhere/x.mkv")


def test_receive_says_what_failed_when_nothing_comes(tmp_path, capsys):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    sdp = tmp_path / "x.sdp"
    sdp.write_text(SDP.format(port=port))
    assert run(receive, "--sdp", sdp, "--seconds", 0.2) == 1
    assert "no packet came" in capsys.readouterr().err
