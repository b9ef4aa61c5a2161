"""`receive --to` with FFmpeg and GStreamer, which decode and count what was sent."""

import contextlib
import json
import socket
import time

import pytest
from media_commands import (
    finish,
    free_ports,
    needs,
    needs_ffmpeg,
    ours,
    output_of,
    player,
    stop,
    wait_for_line,
)
from places import ROOT

from kontur_av.rtp.sdp import StreamDescription, write_sdp

pytestmark = pytest.mark.interop

WIDTH, HEIGHT, SECONDS = 320, 240, 4
CLIP = ROOT / "samples" / "clip.mp4"
#: FFmpeg ends by itself after 12 s without a packet. A signal would cost it the last pictures.
UNTIL_SILENT = "?timeout=12000000"


def ffmpeg(url, *options):
    return player(
        # By itself it looks at 5 s before it decodes: more than is sent.
        *("ffmpeg", "-v", "quiet", "-nostdin", "-analyzeduration", 500_000, *options, "-i", url),
        *("-fps_mode", "passthrough"),
        *("-pix_fmt", "yuv420p", "-f", "rawvideo", "pipe:1"),
    )


def gstreamer(source):
    return player(
        *("gst-launch-1.0", "-q", "-e", *source, "!", "tsdemux", "!", "h264parse", "!"),
        *("avdec_h264", "!", "video/x-raw,format=I420", "!", "fdsink", "fd=1"),
    )


def raw_pictures(output) -> int:
    assert len(output) % (WIDTH * HEIGHT * 3 // 2) == 0
    return len(output) // (WIDTH * HEIGHT * 3 // 2)


def wait_until_bound(port, kind=socket.SOCK_DGRAM) -> None:
    deadline = time.monotonic() + 20
    with contextlib.suppress(OSError):
        while time.monotonic() < deadline:
            with socket.socket(socket.AF_INET, kind) as probe:
                probe.bind(("127.0.0.1", port))
            time.sleep(0.1)
        raise AssertionError(f"nobody listens on port {port}")


@contextlib.contextmanager
def receiving(tmp_path, url, kind="video"):
    """`receive --to URL`, ready for the stream; `port` and `report` are its attributes."""
    port, sdp, report = free_ports(), tmp_path / "x.sdp", tmp_path / "r.json"
    stream = StreamDescription(
        kind=kind, host="127.0.0.1", port=port, payload_type=96, feedback=True
    )
    sdp.write_text(write_sdp(stream))
    with ours("receive", "--sdp", sdp, "--to", url, "--report", report) as receiver:
        wait_for_line(receiver, "waiting")
        receiver.port, receiver.report = port, report
        yield receiver


def send(tmp_path, port, what=("--video", CLIP), seconds=SECONDS):
    """Send to the end; the report."""
    report = tmp_path / "s.json"
    options = () if what[0] == "--audio" else ("--size", f"{WIDTH}x{HEIGHT}", "--fps", 25)
    with ours(
        *("send", *what, *options, "--to", f"127.0.0.1:{port}", "--cap-kbps", 300),
        *("--coded-size", f"{WIDTH}x{HEIGHT}") if options else (),
        *("--seconds", seconds, "--report", report),
    ) as sender:
        finish(sender)
    return json.loads(report.read_text())


def assert_all_came(sent, receiver, counted) -> None:
    finish(receiver)
    forwarded = json.loads(receiver.report.read_text())["forwarded"]
    assert (forwarded["connections"], forwarded["left_out"], forwarded["faults"]) == (1, 0, 0)
    assert forwarded["packets"] == sent["frames_sent"]
    for pictures in counted.values():
        # Neither FFmpeg's nor GStreamer's demuxer is sure of the last picture before the end.
        assert sent["frames_sent"] - 1 <= pictures <= sent["frames_sent"], counted


@pytest.mark.parametrize("name", ["ffmpeg", "gstreamer"])
def test_a_player_decodes_each_picture_of_a_transport_stream(tmp_path, name):
    port = free_ports()
    if name == "ffmpeg":
        needs_ffmpeg()
        shown, count = ffmpeg(f"udp://127.0.0.1:{port}{UNTIL_SILENT}"), raw_pictures
    else:
        needs("tsdemux", "avdec_h264")
        source = ("udpsrc", "address=127.0.0.1", f"port={port}")
        shown, count = gstreamer(source), raw_pictures
    with shown as process:
        wait_until_bound(port)
        with receiving(tmp_path, f"udp://127.0.0.1:{port}") as receiver:
            sent = send(tmp_path, receiver.port)
            output = output_of(process) if name == "ffmpeg" else stop(process)
            assert_all_came(sent, receiver, {name: count(output)})
