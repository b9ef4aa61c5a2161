"""send_numpy.py, receive_numpy.py and talk_async.py: with the cores, and with each other."""

import re
import socket
import subprocess
import sys

from positions import ROOT

SAMPLE = ROOT / "samples" / "send_numpy.py"
OTHER_END = ROOT / "samples" / "receive_numpy.py"
TALK = ROOT / "samples" / "talk_async.py"


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
    # The first ones, too, have number, size and age.
    form = re.compile(r"(\d+): \(480, 640, 3\), [\d.]+ ms old, whole, mean 6")
    numbers = [int(form.match(picture)[1]) for picture in pictures]
    assert numbers == sorted(set(numbers)) and numbers[0] > 0
    assert re.fullmatch(r"\d+ skipped; closed", end)


def test_talk_async(tmp_path):
    words = [sys.executable, TALK, f"127.0.0.1:{free_port()}", tmp_path / "voice.sdp", "2"]
    done = subprocess.run(words, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    real = [line for line in done.stdout.splitlines() if "FRESH" in line]
    assert len(real) >= 50
    assert all(re.match(r"-?\d+ ms old, FRESH, peak \d+", line) for line in real), real
