"""GStreamer's webrtcbin as a partner: it sees and hears us, and is seen and heard."""

import contextlib
import json
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from common import TIMEOUT_S, eventually
from programs import running
from running_session import tcp_port

pytestmark = pytest.mark.interop

PEER = Path(__file__).parents[1] / "helpers" / "webrtcbin_peer.py"
PYTHON = "/usr/bin/python3"
NEEDS = (
    "import gi; gi.require_version('GstWebRTC', '1.0'); from gi.repository import Gst, GstWebRTC; "
    "Gst.init(None); assert Gst.ElementFactory.find('nicesink') and "
    "Gst.ElementFactory.find('webrtcbin')"
)


@pytest.fixture(scope="module", autouse=True)
def bindings():
    try:
        subprocess.run([PYTHON, "-c", NEEDS], check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        pytest.skip(
            "python3-gi: apt-get install python3-gi gir1.2-gst-plugins-bad-1.0 gstreamer1.0-nice"
        )


@pytest.fixture
def start(tmp_path):
    """start(name, *words): a program until the end of the test; its output is in `name`.txt."""
    with contextlib.ExitStack() as begun:

        def begin(name, *words):
            log = tmp_path / f"{name}.txt"
            return begun.enter_context(running(log, *words, end=signal.SIGKILL, cwd=tmp_path))

        yield begin


def test_it_watches_publishes_and_stalls_alone(start, tmp_path):
    token = "word-of-the-partner"
    serve = start(
        "serve",
        *(sys.executable, "-m", "pipelines.cli", "rtc", "serve"),
        *("--http", str(tcp_port())),
        *("--token", token, "--video", "scene:left", "--size", "320x240", "--fps", "15"),
        *("--audio", "scene:ground_voice", "--voice-kbps", "24"),
        *("--report", "report.json", "--save", "seen.mkv", "--save-voice", "heard.mka"),
        *("--raw", "raw.y4m"),
    )
    told = tmp_path / "serve.txt"
    found = eventually(lambda: re.search(r"whep (\S+)/whep/(\S+)", told.read_text()), "the server")
    base, name = found[1], found[2]
    watch = (PYTHON, PEER, "watch", f"{base}/whep/{name}", token)
    stalls = start("watch", *watch)
    start("other", *watch)
    start("publish", PYTHON, PEER, "publish", f"{base}/whip", token)

    def count(what, viewer="watch"):
        counts = re.findall(rf"{what} (\d+)", (tmp_path / f"{viewer}.txt").read_text())
        return int(counts[-1]) if counts else 0

    eventually(lambda: count("pictures") >= 20, "20 of our pictures in GStreamer")
    eventually(lambda: count("sounds") >= 20, "our voice in GStreamer")
    # A viewer that stalls holds up nobody, and sees the present when it goes on.
    stalls.send_signal(signal.SIGSTOP)
    state = Path(f"/proc/{stalls.pid}/status")
    eventually(lambda: "T (stopped)" in state.read_text(), "its stop")
    seen, others = count("pictures"), count("pictures", "other")
    eventually(lambda: count("pictures", "other") > others + 10, "the other's pictures")
    assert count("pictures") == seen
    stalls.send_signal(signal.SIGCONT)
    eventually(lambda: count("pictures") > seen + 10, "pictures after the stall")
    seen = tmp_path / "seen.mkv"
    eventually(lambda: seen.exists() and seen.stat().st_size > 5000, "GStreamer's picture")
    serve.send_signal(signal.SIGINT)
    assert serve.wait(TIMEOUT_S) == 0
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["pictures"]["decoded"] > 0
    assert report["voice"]["decoded"] > 0
    assert report["failed"] == []
    # Each picture that was decoded is in the file, to the last.
    raw = (tmp_path / "raw.y4m").read_bytes()
    assert raw.count(b"FRAME\n") == report["pictures"]["decoded"]
    # Sound waits in the file's buffer until the end.
    assert (tmp_path / "heard.mka").stat().st_size > 1000
