"""send_numpy.py, receive_numpy.py and talk_async.py: with the cores, and with each other."""

import re
import secrets
import socket
import subprocess
import sys
import time

import pytest
from places import ROOT

from kontur_av import H264Decoder, VideoReceiver, parse_sdp, planes

SAMPLE = ROOT / "samples" / "send_numpy.py"
OTHER_END = ROOT / "samples" / "receive_numpy.py"
TALK = ROOT / "samples" / "talk_async.py"


def test_send_numpy(tmp_path):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        udp.bind(("127.0.0.1", 0))
        udp.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        port = udp.getsockname()[1]
        sdp = tmp_path / "picture.sdp"
        command = [sys.executable, SAMPLE, f"127.0.0.1:{port}", "85", sdp, "2"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60)
        assert done.returncode == 0, done.stderr
        stream = parse_sdp(sdp.read_text())
        assert (stream.kind, stream.port) == ("video", port)
        receiver = VideoReceiver(
            ssrc=secrets.randbits(32),
            payload_type=stream.payload_type,
            parameter_sets=stream.parameter_sets,
        )
        decoder = H264Decoder()
        udp.settimeout(0.2)
        pictures = []
        while True:
            try:
                receiver.handle_packet(udp.recv(2048), time.monotonic_ns())
            except TimeoutError:
                break
            while (unit := receiver.next_event()) is not None:
                pictures += decoder.decode(unit.data, unit.timestamp)
    # Only the cap is asserted, because the rate depends on the machine.
    assert len(pictures) >= 10
    counts = receiver.counts.rtp
    assert counts.rtp_lost == counts.garbage == decoder.counts.frames_corrupt == 0
    assert 0 < counts.rtp_payload_octets * 8 <= 2 * 85_000 * 1.1
    luma = planes(pictures[-1].to_i420())[0]
    assert luma.max() > 120
    assert "largest second" in done.stdout


def free_port():
    """The first of two free neighbouring UDP ports."""
    while True:
        with (
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as rtp,
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as rtcp,
        ):
            rtp.bind(("127.0.0.1", 0))
            port = rtp.getsockname()[1]
            try:
                rtcp.bind(("127.0.0.1", port + 1))
            except OSError:
                continue
            return port


def test_both_ends_together(tmp_path):
    sdp, port = tmp_path / "picture.sdp", free_port()
    words = [sys.executable, SAMPLE, f"127.0.0.1:{port}", "85", sdp, "60"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as sender:
        try:
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as before:
                before.bind(("127.0.0.1", port))
                before.settimeout(30)
                for _ in range(5):
                    before.recv(2048)
            # It joins a running stream, and asks for a whole picture.
            done = subprocess.run(
                [sys.executable, OTHER_END, sdp, "120"], capture_output=True, text=True, timeout=60
            )
        finally:
            sender.terminate()
    assert done.returncode == 0, done.stderr
    *pictures, end = done.stdout.splitlines()
    assert len(pictures) == 120
    found = [re.match(r"\(\d+, \d+, 3\), (no|-?[\d.]+ ms) .*, FRESH, mean 6", p) for p in pictures]
    # The first ones have no age: a report comes within 1.23 s, 37 pictures.
    ages = [match.group(1) for match in found if match]
    assert len(ages) == 120, pictures
    assert "no" not in ages[60:], pictures
    assert re.fullmatch(r"\d+ skipped; closed", end)


def test_talk_async(tmp_path):
    words = [sys.executable, TALK, f"127.0.0.1:{free_port()}", tmp_path / "voice.sdp", "2"]
    done = subprocess.run(words, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    real = [line for line in done.stdout.splitlines() if "FRESH" in line]
    assert len(real) >= 50
    assert all(re.match(r"-?\d+ ms old, FRESH, peak \d+", line) for line in real), real


@pytest.mark.parametrize("sample", [SAMPLE, OTHER_END, TALK])
def test_what_a_sample_does_takes_at_most_fifteen_lines(sample):
    statements = [
        line
        for line in sample.read_text(encoding="utf-8").split('"""')[2].splitlines()
        if line.strip() and not re.match(r"import |from ", line)
    ]
    assert len(statements) <= 15
