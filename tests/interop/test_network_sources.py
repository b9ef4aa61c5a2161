"""Sources in a network: RTSP servers by other makers, and HTTP, over real sockets."""

import json
import signal
import socket
import time
from itertools import pairwise

import pytest
from common import TIMEOUT_S, eventually, free_port
from media_commands import ours
from network_camera import USER
from programs import camera_server, media_server

from kontur_av.clock import NS_PER_S, MonotonicClock
from kontur_av.errors import ConfigError
from kontur_av.media import empty_picture, planes
from kontur_av.sources import check_spec, network, open_video
from kontur_av.sources.network import NetworkVideo
from pipelines.cli import main

PICTURE = empty_picture(640, 480)


def read_pictures(source, count=5):
    """Read so many pictures; return the stamp of the last, and its age."""
    for _ in range(count):
        stamp = eventually(lambda: source.read(PICTURE, NS_PER_S // 10), "a picture")
    return stamp, MonotonicClock.now_ns() - stamp.capture_ns


def lose(source):
    eventually(lambda: source.read(PICTURE, 0) is None and source.faults, "a fault")
    return source.last_fault


@pytest.mark.parametrize(
    ("server", "scheme", "path", "dated_by"),
    [
        (media_server, "rtsp", "h264", "source"),
        (media_server, "rtspu", "h264", "source"),
        (media_server, "rtsp", "h265", "source"),
        (camera_server, "rtsp", "stream", "arrival"),
        (camera_server, "http", "mjpeg", "arrival"),
    ],
)
def test_a_stream_is_dated_and_survives_a_restart(tmp_path, server, scheme, path, dated_by):
    port = free_port(socket.SOCK_STREAM)
    option = scheme if server is camera_server else USER
    url = f"{scheme}://{USER}@127.0.0.1:{port}/{path}"
    with server(tmp_path / "1.txt", port, option):
        source = open_video(url)
        read_pictures(source)
        assert planes(PICTURE)[0].std() > 10
        # GStreamer reports its clock after some seconds.
        eventually(lambda: read_pictures(source) and source.dated_by == dated_by, dated_by)
        stamp, age_ns = read_pictures(source)
        # Coded, sent, and held by the parser until the next picture begins.
        assert age_ns > (NS_PER_S // 60 if dated_by == "source" else 0)
    assert lose(source).startswith(f"{scheme}://127.0.0.1:{port}/{path}: ")
    with server(tmp_path / "2.txt", port, option):
        assert read_pictures(source, 50)[0].sequence > stamp.sequence
        source.close()


def test_a_stalled_server_is_reported_and_stops_no_process(tmp_path, monkeypatch):
    port = free_port(socket.SOCK_STREAM)
    url = f"rtsp://127.0.0.1:{port}/h264"
    with media_server(tmp_path / "1.txt", port) as server:
        with ours("send", "--video", url, "--to", "127.0.0.1:9", "--cap-kbps", 200,
                  "--report", tmp_path / "r.json") as sender:  # fmt: skip
            assert "sent in" in eventually(sender.stdout.readline)
            server.send_signal(signal.SIGSTOP)
            stalled = f"{url}: nothing came for 5 s"
            eventually(lambda: sender.stdout.readline().startswith(stalled), "the reason")
            server.send_signal(signal.SIGCONT)
            counts = (int(line.split()[2]) for line in sender.stdout if "captured" in line)
            before = next(counts)
            eventually(lambda: next(counts) > before, "pictures again")
            server.send_signal(signal.SIGSTOP)
            sender.send_signal(signal.SIGINT)
            assert sender.wait(TIMEOUT_S) == 0
        report = json.loads((tmp_path / "r.json").read_text())
        assert report["failed"] == [] and report["source"]["faults"] >= 1
        # A server that only accepts connections; it is waited for more briefly here.
        monkeypatch.setattr(network, "_OPEN_S", 2.0)
        with pytest.raises(ConfigError, match="no answer within 10 s"):
            check_spec(url, "video")


def test_a_decoder_that_is_too_slow_leaves_pictures_out(tmp_path, monkeypatch):
    times = []

    def slow(_, packet, frame, now_ns):
        times.extend([] if frame.time is None else [frame.time])
        time.sleep(0.05)

    monkeypatch.setattr(NetworkVideo, "_stated_ns", slow)
    port = free_port(socket.SOCK_STREAM)
    with media_server(tmp_path / "1.txt", port):
        source = open_video(f"rtsp://127.0.0.1:{port}/h264")
        eventually(lambda: any(b - a > 0.1 for a, b in pairwise([*times])), "a gap")
        source.close()


def test_what_cannot_work_is_one_line_without_the_password(tmp_path, capsys):
    ports = [free_port(socket.SOCK_STREAM) for _ in range(3)]
    rtsp, web, none = (f"127.0.0.1:{port}" for port in ports)
    (tmp_path / "a.sdp").write_text(
        "v=0\r\no=- 0 0 IN IP4 127.0.0.1\r\ns=-\r\nc=IN IP4 127.0.0.1\r\nt=0 0\r\n"
        f"m=video {free_port(more=1)} RTP/AVP 96\r\na=rtpmap:96 NONE/90000\r\n"
    )
    with (
        media_server(tmp_path / "1.txt", ports[0], USER),
        camera_server(tmp_path / "2.txt", ports[1], "http"),
    ):
        for spec, words in (
            (f"rtsp://bob:S3cret-2@{rtsp}/h264", "user name or password is refused (401)"),
            (f"rtsp://{USER}@{rtsp}/none", "there is no such stream (404)"),
            (f"rtsp://{USER}@{rtsp}/sound", "may have no pictures"),
            (f"http://bob:S3cret-2@{web}/mjpeg", "user name or password is refused (401)"),
            (f"http://{USER}@{web}/none", "there is no such stream (404)"),
            (f"rtsp://{USER}@{none}/x", "nothing listens"),
            (f"srt://{USER}@{none}", "relay it to udp://127.0.0.1:PORT"),
            (f"rtp:{tmp_path}/a.sdp", "FFmpeg cannot decode its pictures"),
        ):
            assert main(["send", "--video", spec, "--to", "127.0.0.1:9", "--cap-kbps", "200"]) == 2
            (line,) = capsys.readouterr().err.splitlines()
            assert words in line and "S3cret" not in line
        # In a session it is not waited for; it is tried again, once a minute.
        source = open_video(f"rtsp://bob:S3cret-2@{rtsp}/h264", wait=False)
        assert "S3cret" not in lose(source) and source.faults == 1
        source.close()
