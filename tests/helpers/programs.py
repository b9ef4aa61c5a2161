"""Programs by other makers: a test that lacks one is skipped, and says how to get it."""

import contextlib
import importlib.util
import shutil
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from common import TIMEOUT_S, eventually

SYSTEM_PYTHON = "/usr/bin/python3"
MEDIA_SERVER = Path(__file__).with_name("media_server.py")
_PLUGINS = "gstreamer1.0-plugins-{base,good,bad,ugly} gstreamer1.0-libav"
#: Where another name is needed than the program's: packages of Debian.
_PACKAGES = {
    "chromedriver": "chromium-driver",
    "cvlc": "vlc-bin vlc-plugin-base vlc-plugin-access-extra",
    "dot": "graphviz",
    "gst-launch-1.0": "gstreamer1.0-tools",
    "ip": "iproute2",
    "node": "nodejs",
    "octave-cli": "octave",
    "turnserver": "coturn",
}


def needs(*names: str) -> None:
    """Skip the test unless all these programs are there."""
    for name in names:
        if shutil.which(name) is None:
            pytest.skip(f"{name}: apt-get install {_PACKAGES.get(name, name)}")


def needs_elements(*elements: str) -> None:
    """Skip the test unless GStreamer has all these elements."""
    needs("gst-launch-1.0")
    for element in elements:
        if subprocess.run(["gst-inspect-1.0", "--exists", element], check=False).returncode:
            pytest.skip(f"gst-launch-1.0 without {element}: apt-get install {_PLUGINS}")


def needs_media_server() -> None:
    """Skip the test unless GStreamer's RTSP server can be run."""
    found = [SYSTEM_PYTHON, MEDIA_SERVER, "--check"]
    if subprocess.run(found, stderr=subprocess.DEVNULL, check=False).returncode:
        pytest.skip("python3-gi: apt-get install python3-gi gir1.2-gst-rtsp-server-1.0")


@contextlib.contextmanager
def running(log, *command, end=signal.SIGINT, patience_s=TIMEOUT_S, **options):
    """A program, its output in the file `log`; the signal `end` ends it, unless it has ended."""
    with log.open("w") as out:
        process = subprocess.Popen([*map(str, command)], stdout=out, stderr=out, **options)
    try:
        yield process
    finally:
        process.send_signal(end)
        try:
            process.wait(patience_s)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def media_server(log, port, *user):
    """GStreamer's RTSP server, as a context; killed at the end."""
    needs_media_server()
    needs_elements("x264enc", "x265enc", "rtph264pay", "rtph265pay")
    return _listening(log, SYSTEM_PYTHON, MEDIA_SERVER, port, *user)


def camera_server(log, port, kind):
    """`network_camera`, as a context; killed at the end."""
    if kind == "rtsp" and importlib.util.find_spec("rtsp") is None:
        pytest.skip("rtsp-rs: pip install -e '.[full]'")
    return _listening(log, sys.executable, MEDIA_SERVER.with_name("network_camera.py"), port, kind)


@contextlib.contextmanager
def _listening(log, python, script, port, *words):
    with running(log, python, script, port, *words, end=signal.SIGKILL) as server:
        eventually(lambda: socket.socket().connect_ex(("127.0.0.1", port)) == 0, "the server")
        yield server
