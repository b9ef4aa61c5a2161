"""`receive --to` with VLC, FFmpeg and GStreamer, which decode and count what was sent."""

import contextlib
import io
import json
import os
import shutil
import socket
import time

import av
import numpy as np
import pytest
from media_commands import (
    finish,
    free_ports,
    needs,
    needs_ffmpeg,
    ours,
    output_of,
    player,
    started,
    stop,
    wait_for_line,
)
from places import ROOT

from kontur_av.rtp.sdp import StreamDescription, write_sdp

pytestmark = pytest.mark.interop

WIDTH, HEIGHT, SECONDS = 320, 240, 4
CLIP = ROOT / "samples" / "clip.mp4"
#: Of the pictures that were sent. VLC shows none before its first look at the stream is over.
MOST_MISSING = 0.5
#: FFmpeg ends by itself after 12 s without a packet. A signal would cost it the last pictures.
UNTIL_SILENT = "?timeout=12000000"


def needs_vlc() -> None:
    if shutil.which("cvlc") is None:
        pytest.skip("cvlc is missing: install vlc-bin and vlc-plugin-base")


def vlc(url, kind="video"):
    """VLC, which decodes all and writes it, coded anew, to its output; it refuses to be root."""
    user = ("setpriv", "--reuid=65534", "--regid=65534", "--clear-groups", "env", "HOME=/tmp")
    coded = {
        "video": "#transcode{vcodec=mp4v,vb=4000}:std{access=file,mux=ts,dst=-}",
        "audio": "#transcode{acodec=s16l,channels=1,samplerate=48000}:"
        "std{access=file,mux=wav,dst=-}",
    }
    return player(
        *(user if os.geteuid() == 0 else ()),
        *("cvlc", "-q", "-I", "dummy", "--network-caching", 500, "--sout", coded[kind], url),
    )


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


def pictures_of_vlc(output) -> int:
    with av.open(io.BytesIO(output)) as container:
        # Each is one that it decoded, and coded anew.
        return sum(1 for packet in container.demux(video=0) if packet.size)


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
    for name, pictures in counted.items():
        least = 1 - MOST_MISSING if name == "vlc" else 1
        # Neither FFmpeg's nor GStreamer's demuxer is sure of the last picture before the end.
        assert least * sent["frames_sent"] - 1 <= pictures <= sent["frames_sent"], counted


@pytest.mark.parametrize("name", ["vlc", "ffmpeg", "gstreamer"])
def test_a_player_decodes_each_picture_of_a_transport_stream(tmp_path, name):
    port = free_ports()
    if name == "vlc":
        needs_vlc()
        shown, count = vlc(f"udp://@127.0.0.1:{port}"), pictures_of_vlc
    elif name == "ffmpeg":
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


def test_vlc_plays_the_sound(tmp_path):
    needs_vlc()
    port = free_ports()
    with vlc(f"udp://@127.0.0.1:{port}", "audio") as one:
        wait_until_bound(port)
        with receiving(tmp_path, f"udp://127.0.0.1:{port}", "audio") as receiver:
            sent = send(tmp_path, receiver.port, ("--audio", "scene:ground_voice"))
            finish(receiver)
        output = stop(one)
    samples = output[output.index(b"data") + 8 :]
    heard = np.frombuffer(samples[: len(samples) // 2 * 2], "<i2")
    forwarded = json.loads(receiver.report.read_text())["forwarded"]
    assert forwarded["packets"] == sent["frames_sent"]
    assert 0.8 * SECONDS * 48_000 < len(heard) < 1.1 * SECONDS * 48_000
    assert np.std(heard.astype(float)) > 100


def test_three_players_take_the_stream_from_a_relay_by_srt(tmp_path):
    needs("tsdemux", "avdec_h264", "srtsrc", "srtsink")
    needs_ffmpeg()
    needs_vlc()
    port, srt = free_ports(), free_ports()
    url = f"srt://127.0.0.1:{srt}"
    relay = started(
        *("gst-launch-1.0", "-q", "udpsrc", "address=127.0.0.1", f"port={port}", "!"),
        *("srtsink", f"uri={url}?mode=listener", "wait-for-connection=false"),
    )
    with relay:
        wait_until_bound(srt)
        with (
            vlc(url) as one,
            ffmpeg(url + UNTIL_SILENT) as other,
            gstreamer(("srtsrc", f"uri={url}")) as third,
            receiving(tmp_path, f"udp://127.0.0.1:{port}") as receiver,
        ):
            sent = send(tmp_path, receiver.port)
            counted = {
                "vlc": pictures_of_vlc(stop(one)),
                "ffmpeg": raw_pictures(output_of(other)),
                "gstreamer": raw_pictures(stop(third)),
            }
            assert_all_came(sent, receiver, counted)


def test_a_server_that_comes_late_gets_the_stream_from_a_key_picture_on(tmp_path):
    needs_ffmpeg()
    url = f"rtsp://127.0.0.1:{free_ports()}/arm"
    with (
        receiving(tmp_path, url) as receiver,
        ours(
            *("send", "--video", CLIP, "--to", f"127.0.0.1:{receiver.port}", "--seconds", 12),
            *("--cap-kbps", 300, "--size", f"{WIDTH}x{HEIGHT}", "--fps", 25),
        ) as sender,
    ):
        wait_for_line(receiver, "Connection refused; tried again every second")
        with ffmpeg(url, "-rtsp_flags", "listen") as server:
            wait_for_line(receiver, "the stream goes there")
            finish(sender)
            finish(receiver)
            output, _ = server.communicate(timeout=20)
    report = json.loads(receiver.report.read_text())
    forwarded = report["forwarded"]
    assert forwarded["connections"] == 1 and forwarded["faults"] >= 1
    assert report["failed"] == [] and report["pictures_asked_for"] > 0
    assert forwarded["packets"] - 1 <= raw_pictures(output) <= forwarded["packets"]
    # By its next wave alone, the picture would be renewed after 60 s.
    assert 25 < forwarded["packets"] < report["frames_received"]


def test_a_server_that_never_answers_stops_neither_the_stream_nor_the_command(tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as deaf:
        url = f"rtsp://anna:secret@127.0.0.1:{deaf.getsockname()[1]}/arm"
        with receiving(tmp_path, url) as receiver:
            sent = send(tmp_path, receiver.port, seconds=6)
            output, _ = receiver.communicate(timeout=30)
    report = json.loads(receiver.report.read_text())
    assert receiver.returncode == 1
    assert report["frames_decoded"] == sent["frames_sent"]
    assert report["rtp_lost"] == 0
    assert report["forwarded"]["packets"] == 0
    assert report["forwarded"]["left_out"] == report["frames_received"]
    shown = url.replace("anna:secret@", "")
    assert report["failed"] == [f"--to {shown}: no answer"]
    assert "secret" not in output + receiver.report.read_text()
