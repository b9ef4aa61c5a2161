"""Sources in a network: RTSP servers by other makers, and HTTP over real sockets."""

import contextlib
import http.server
import importlib.util
import json
import signal
import socket
import subprocess
import sys
import threading
import time
from base64 import b64encode
from pathlib import Path

import cv2
import numpy as np
import pytest
from common import TIMEOUT_S, eventually, free_port
from media_commands import ours
from programs import MEDIA_SERVER, SYSTEM_PYTHON, needs_elements, needs_media_server, running

from kontur_av.clock import NS_PER_S, MonotonicClock
from kontur_av.errors import ConfigError
from kontur_av.media import empty_picture, planes
from kontur_av.sources import check_spec, open_video
from pipelines.cli import main

RTSP_RS = Path(__file__).parents[1] / "helpers" / "rtsp_rs_server.py"
SIZE = 320, 240
USER = "bob:S3cret-1"


def gstreamer(port, *user):
    needs_media_server()
    needs_elements("x264enc", "x265enc", "rtph264pay", "rtph265pay")
    return SYSTEM_PYTHON, MEDIA_SERVER, port, *user


def rtsp_rs(port):
    if importlib.util.find_spec("rtsp") is None:
        pytest.skip("rtsp-rs: pip install -e '.[full]'")
    return sys.executable, RTSP_RS, port


@contextlib.contextmanager
def serving(tmp_path, command):
    port = int(command[2])
    with running(tmp_path / "server.txt", *command, end=signal.SIGKILL) as server:
        eventually(lambda: socket.socket().connect_ex(("127.0.0.1", port)) == 0, "the server")
        yield server


def opened(url, **options):
    width, height = SIZE
    return open_video(url, name="head", width=width, height=height, **options)


def read_pictures(source, count=5):
    """Read so many pictures; return the last, its stamp and when it was read."""
    picture = empty_picture(*SIZE)
    for _ in range(count):
        stamp = eventually(lambda: source.read(picture, NS_PER_S // 10), "a picture")
    return picture, stamp, MonotonicClock.now_ns()


@pytest.mark.parametrize(
    ("server", "path", "dated_by"),
    [
        (gstreamer, "rtsp://{}/h264", "source"),
        (gstreamer, "rtspu://{}/h264", "source"),
        (gstreamer, "rtsp://{}/h265", "source"),
        (rtsp_rs, "rtsp://{}/stream", "arrival"),
    ],
)
def test_a_stream_is_dated_and_survives_a_restart_of_its_server(tmp_path, server, path, dated_by):
    command = server(free_port(socket.SOCK_STREAM))
    url = path.format(f"127.0.0.1:{command[2]}")
    with contextlib.ExitStack() as stack:
        with serving(tmp_path, command):
            source = opened(url)
            stack.callback(source.close)
            picture, *_ = read_pictures(source)
            assert planes(picture)[0].std() > 10
            # GStreamer reports its clock after some seconds.
            eventually(lambda: read_pictures(source)[0] is not None and source.dated_by == dated_by)
            _, stamp, now_ns = read_pictures(source)
            assert stamp.capture_ns <= now_ns
            if dated_by == "source":
                # Coded, sent, and held by the parser until the next picture begins.
                assert now_ns - stamp.capture_ns > NS_PER_S // 60
        eventually(lambda: source.read(picture, 0) is None and source.faults, "the fault")
        assert source.last_fault.startswith(f"{url}: ")
        with serving(tmp_path, command):
            assert read_pictures(source, 50)[1].sequence > stamp.sequence


def test_a_stalled_server_is_reported_and_stops_no_process(tmp_path):
    command = gstreamer(free_port(socket.SOCK_STREAM))
    url = f"rtsp://127.0.0.1:{command[2]}/h264"
    with serving(tmp_path, command) as server:
        with ours("send", "--video", url, "--to", "127.0.0.1:9", "--cap-kbps", 200,
                  "--report", tmp_path / "r.json") as sender:  # fmt: skip
            assert "sent in" in eventually(sender.stdout.readline)
            server.send_signal(signal.SIGSTOP)
            stalled = f"{url}: nothing came for 5 s"
            eventually(lambda: sender.stdout.readline().startswith(stalled), "the reason")
            server.send_signal(signal.SIGCONT)
            captured = []

            def goes_on():
                words = sender.stdout.readline().split()
                captured.append(int(words[2]) if words[3:4] == ["captured,"] else 0)
                return len(captured) > 3 and captured[-1] > captured[-2] > captured[-3] > 0

            eventually(goes_on, "pictures again")
            server.send_signal(signal.SIGSTOP)
            sender.send_signal(signal.SIGINT)
            assert sender.wait(TIMEOUT_S) == 0
        report = json.loads((tmp_path / "r.json").read_text())
        assert report["failed"] == [] and report["source"]["faults"] >= 1
        # A server that only accepts connections.
        with pytest.raises(ConfigError, match="no answer within 10 s"):
            check_spec(url, "video")


def test_what_cannot_work_is_one_line_without_the_password(tmp_path, capsys):
    command = gstreamer(free_port(socket.SOCK_STREAM), USER)
    host = f"127.0.0.1:{command[2]}"
    with serving(tmp_path, command):
        opened(f"rtsp://{USER}@{host}/h264").close()
        for url, words in (
            (f"rtsp://bob:S3cret-2@{host}/h264", "user name or password is refused (401)"),
            (f"rtsp://{USER}@{host}/none", "there is no such stream (404)"),
            (f"rtsp://{USER}@{host}/sound", "may have no pictures"),
            (f"rtsp://bob:S3cret-1@127.0.0.1:{free_port(socket.SOCK_STREAM)}/x", "nothing listens"),
            ("srt://bob:S3cret-1@127.0.0.1:9", "relay it to udp://127.0.0.1:PORT"),
        ):
            assert main(["send", "--video", url, "--to", "127.0.0.1:9", "--cap-kbps", "200"]) == 2
            (line,) = capsys.readouterr().err.splitlines()
            assert words in line and "S3cret" not in line
        # In a session it is not waited for; it is tried again, once a minute.
        source = opened(f"rtsp://bob:S3cret-2@{host}/h264", wait=False)
        eventually(lambda: source.faults, "the fault")
        assert source.faults == 1 and "S3cret" not in source.last_fault
        source.close()
    (tmp_path / "a.sdp").write_text(
        "v=0\r\no=- 0 0 IN IP4 127.0.0.1\r\ns=-\r\nc=IN IP4 127.0.0.1\r\nt=0 0\r\n"
        f"m=video {free_port(more=1)} RTP/AVP 96\r\na=rtpmap:96 NONE/90000\r\n"
    )
    with pytest.raises(ConfigError, match="FFmpeg cannot decode its pictures"):
        check_spec(f"rtp:{tmp_path}/a.sdp", "video")


class Camera(http.server.BaseHTTPRequestHandler):
    """MJPEG, as IP cameras send it."""

    def do_GET(self):
        known = self.headers["Authorization"] == f"Basic {b64encode(USER.encode()).decode()}"
        self.send_response((200 if known else 401) if self.path == "/mjpeg" else 404)
        self.send_header("WWW-Authenticate", 'Basic realm="camera"')
        self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=picture")
        self.end_headers()
        if not known:
            return
        grey = cv2.imencode(".jpg", np.full((*SIZE[::-1], 3), 90, np.uint8))[1].tobytes()
        with contextlib.suppress(OSError):
            while not self.server.ending.is_set():
                head = f"--picture\r\nContent-Type: image/jpeg\r\nContent-Length: {len(grey)}"
                self.wfile.write(head.encode() + b"\r\n\r\n" + grey + b"\r\n")
                time.sleep(1 / 30)

    def log_message(self, *_):
        pass


@contextlib.contextmanager
def camera(port):
    server = http.server.ThreadingHTTPServer(("127.0.0.1", port), Camera)
    server.ending = threading.Event()
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield
    finally:
        server.ending.set()
        server.shutdown()
        server.server_close()


def test_motion_jpeg_over_http_survives_a_restart_too():
    port = free_port(socket.SOCK_STREAM)
    with camera(port):
        for path, code in (("127.0.0.1:{}/none", 404), ("bob:S3cret-2@127.0.0.1:{}/mjpeg", 401)):
            with pytest.raises(ConfigError, match=rf"\({code}\)"):
                check_spec("http://" + path.format(port), "video")
        source = opened(f"http://{USER}@127.0.0.1:{port}/mjpeg")
        picture, stamp, _ = read_pictures(source)
        # BT.601 in narrow range.
        assert abs(int(np.median(planes(picture)[0])) - (16 + 90 * 219 / 255)) < 3
    eventually(lambda: source.read(picture, 0) is None and source.faults, "the fault")
    assert source.last_fault.startswith(f"http://127.0.0.1:{port}/mjpeg: ")
    with camera(port):
        assert read_pictures(source, 50)[1].sequence > stamp.sequence
        source.close()


def test_a_program_ends_while_its_camera_is_stalled(tmp_path):
    command = gstreamer(free_port(socket.SOCK_STREAM))
    program = """
import sys
import kontur_av as ka
camera = ka.open_video(sys.argv[1])
picture = ka.empty_picture(640, 480)
print(camera.read(picture, 10**10), flush=True)
sys.stdin.readline()
"""
    with serving(tmp_path, command) as server:
        words = [sys.executable, "-c", program, f"rtsp://127.0.0.1:{command[2]}/h264"]
        with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as user:
            assert b"CaptureStamp" in user.stdout.readline()
            server.send_signal(signal.SIGSTOP)
            user.communicate(b"\n", timeout=TIMEOUT_S)
            assert user.returncode == 0
