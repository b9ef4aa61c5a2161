"""VLC, FFmpeg and GStreamer take what `send` and `receive --to` make, and decode each picture."""

import contextlib
import json
import os
import signal
import socket
import subprocess

import pytest
from common import TIMEOUT_S, eventually
from media_commands import finish, ours, output_of, player, started, wait_for_line
from positions import ROOT
from programs import MEDIA_SERVER, SYSTEM_PYTHON, needs, needs_elements, needs_media_server
from running_session import free_pair

from kontur_av.rtp.sdp import StreamDescription, write_sdp

pytestmark = pytest.mark.interop

WIDTH, HEIGHT, SECONDS = 320, 240, 2
PICTURE_OCTETS = WIDTH * HEIGHT * 3 // 2
CLIP = ROOT / "samples" / "clip.mp4"
#: Pictures that are not shown. FFmpeg's and GStreamer's demuxers are not sure of the last ones
#: before the end. VLC looks at a stream before it shows it.
KEPT = {"ffmpeg": 3, "gstreamer": 1, "vlc": 20}


def vlc(*source, stdin=subprocess.DEVNULL):
    """It refuses to be root."""
    user = ("setpriv", "--reuid=65534", "--regid=65534", "--clear-groups", "env", "HOME=/tmp")
    return player(
        *(user if os.geteuid() == 0 else ()),
        *("cvlc", "-q", "--network-caching=500", "--avcodec-threads=1", "--sout"),
        *("#transcode{vcodec=I420}:std{access=file,mux=dummy,dst=-}", *source),
        stdin=stdin,
    )


def ffmpeg(url, *options):
    return player(
        # By itself it looks at 5 s before it decodes: more than is sent.
        *("ffmpeg", "-v", "quiet", "-nostdin", "-analyzeduration", 500_000, *options),
        *("-threads", 1, "-i", url, "-fps_mode", "passthrough"),
        *("-pix_fmt", "yuv420p", "-f", "rawvideo", "pipe:1"),
    )


def gstreamer(*source):
    return player(
        *("gst-launch-1.0", "-q", *source, "!", "tsdemux", "!", "h264parse", "!"),
        *("avdec_h264", "max-threads=1", "!", "video/x-raw,format=I420", "!"),
        *("fdsink", "fd=1", "sync=false"),
    )


def wait_until_bound(port, kind=socket.SOCK_DGRAM) -> None:
    def bound():
        with socket.socket(socket.AF_INET, kind) as probe, contextlib.suppress(OSError):
            probe.bind(("127.0.0.1", port))
            return False
        return True

    eventually(bound, f"a listener on port {port}", pause_s=0.1)


def description(path, port):
    stream = StreamDescription(
        kind="video", host="127.0.0.1", port=port, payload_type=96, feedback=True
    )
    path.write_text(write_sdp(stream))
    return path


@contextlib.contextmanager
def receiving(tmp_path, url):
    """`receive --to URL`, ready for the stream; `port` and `report` are its attributes."""
    port, report = free_pair(), tmp_path / "r.json"
    sdp = description(tmp_path / "x.sdp", port)
    with ours("receive", "--sdp", sdp, "--to", url, "--report", report) as receiver:
        wait_for_line(receiver, "waiting")
        receiver.port, receiver.report = port, report
        yield receiver


def sending(tmp_path, port, seconds=SECONDS):
    return ours(
        *("send", "--video", CLIP, "--to", f"127.0.0.1:{port}", "--cap-kbps", 300),
        *("--size", f"{WIDTH}x{HEIGHT}", "--coded-size", f"{WIDTH}x{HEIGHT}", "--fps", 25),
        *("--seconds", seconds, "--report", tmp_path / "s.json"),
    )


def send(tmp_path, port, seconds=SECONDS) -> int:
    """Send to the end; how many pictures."""
    with sending(tmp_path, port, seconds) as sender:
        finish(sender)
    return json.loads((tmp_path / "s.json").read_text())["frames_sent"]


def assert_shown(name, process, sent) -> None:
    least = sent - KEPT[name]
    enough = least * PICTURE_OCTETS
    output = output_of(process, enough)
    assert least <= len(output) // PICTURE_OCTETS <= sent, name


def assert_handed_on(receiver, sent) -> None:
    finish(receiver)
    forwarded = json.loads(receiver.report.read_text())["forwarded"]
    assert (forwarded["connections"], forwarded["left_out"], forwarded["faults"]) == (1, 0, 0)
    assert forwarded["packets"] == sent


def test_vlc_opens_the_sdp_by_the_reader_of_ffmpeg(tmp_path):
    needs("cvlc")
    port = free_pair()
    with (
        description(tmp_path / "x.sdp", port).open() as sdp,
        # It may not read this directory of root's.
        vlc("--demux=avformat", "fd://0", stdin=sdp) as process,
    ):
        wait_until_bound(port)
        sent = send(tmp_path, port)
        assert_shown("vlc", process, sent)


def test_three_players_take_the_stream_by_srt_from_gstreamers_relay(tmp_path):
    needs_elements("tsdemux", "avdec_h264", "srtsrc", "srtsink")
    needs("ffmpeg", "cvlc")
    port, srt = free_pair(), free_pair()
    url = f"srt://127.0.0.1:{srt}"
    relay = started(
        *("gst-launch-1.0", "-q", "udpsrc", "address=127.0.0.1", f"port={port}", "!"),
        *("srtsink", f"uri={url}?mode=listener", "wait-for-connection=false"),
    )
    with relay as relaying:
        wait_until_bound(srt)
        with (
            vlc(url) as one,
            ffmpeg(url) as other,
            gstreamer("srtsrc", f"uri={url}") as third,
            receiving(tmp_path, f"udp://127.0.0.1:{port}") as receiver,
        ):
            sent = send(tmp_path, receiver.port)
            assert_shown("gstreamer", third, sent)
            # It then ends its connections; else their players would wait for 5 s.
            relaying.send_signal(signal.SIGINT)
            assert_shown("ffmpeg", other, sent)
            assert_shown("vlc", one, sent)
            assert_handed_on(receiver, sent)


def test_gstreamers_media_server_records_each_picture(tmp_path):
    needs_elements("rtph264depay", "avdec_h264")
    needs_media_server()
    port = free_pair()
    with player(SYSTEM_PYTHON, MEDIA_SERVER, port) as server:
        wait_until_bound(port, socket.SOCK_STREAM)
        with receiving(tmp_path, f"rtsp://127.0.0.1:{port}/arm") as receiver:
            sent = send(tmp_path, receiver.port)
            assert_shown("gstreamer", server, sent)
            assert_handed_on(receiver, sent)


def test_a_server_that_comes_late_gets_the_stream_from_a_key_picture_on(tmp_path):
    needs("ffmpeg")
    url = f"rtsp://127.0.0.1:{free_pair()}/arm"
    with (
        receiving(tmp_path, url) as receiver,
        sending(tmp_path, receiver.port, seconds=600) as sender,
    ):
        wait_for_line(receiver, "Connection refused; tried again every second")
        with ffmpeg(url, "-rtsp_flags", "listen") as server:
            wait_for_line(receiver, "the stream goes there")
            enough = 40 * PICTURE_OCTETS
            eventually(lambda: os.fstat(server.data.fileno()).st_size > enough, "40 pictures")
            sender.send_signal(signal.SIGINT)
            finish(sender)
            finish(receiver)
            report = json.loads(receiver.report.read_text())
            forwarded = report["forwarded"]
            assert_shown("ffmpeg", server, forwarded["packets"])
    assert forwarded["connections"] == 1 and forwarded["faults"] >= 1
    assert report["failed"] == [] and report["pictures_asked_for"] > 0
    # By its next wave alone, the picture would be renewed after 60 s.
    assert 25 < forwarded["packets"] < report["frames_received"]


def test_a_server_that_never_answers_stops_neither_the_stream_nor_the_command(tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as deaf:
        url = f"rtsp://anna:secret@127.0.0.1:{deaf.getsockname()[1]}/arm"
        with receiving(tmp_path, url) as receiver:
            sent = send(tmp_path, receiver.port)
            output, _ = receiver.communicate(timeout=TIMEOUT_S)
    report = json.loads(receiver.report.read_text())
    assert receiver.returncode == 1
    assert report["frames_decoded"] == sent
    assert report["rtp_lost"] == 0
    assert report["forwarded"]["packets"] == 0
    assert report["forwarded"]["left_out"] == report["frames_received"]
    shown = url.replace("anna:secret@", "")
    assert report["failed"] == [f"--to {shown}: no answer"]
    assert "secret" not in output + receiver.report.read_text()
