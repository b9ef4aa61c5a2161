"""`send` and `receive` of plain RTP in this process: what they say, save and offer."""

import argparse
import os
import signal
import socket
from threading import Event, Thread

import numpy as np
import pytest
from common import eventually, free_port

from kontur_av.codecs.coding import SLOW_REFRESH_S
from kontur_av.codecs.h26x import H264Encoder
from kontur_av.media import CaptureStamp, VideoFrame, empty_picture
from kontur_av.rtp.annex_b import split_annex_b
from kontur_av.rtp.nal_formats import H264, H264_SPS
from pipelines.commands import receive, send


def run(command, *options) -> int:
    parser = argparse.ArgumentParser()
    command.add_arguments(parser)
    return command.run(parser.parse_args([str(option) for option in options]))


@pytest.fixture
def described(tmp_path):
    """The file of an SDP, and its port."""
    port = free_port(more=2)
    port += port & 1
    (tmp_path / "x.sdp").write_text(
        f"v=0\nc=IN IP4 127.0.0.1\nm=audio {port} RTP/AVP 97\na=rtpmap:97 opus/48000/2\n"
    )
    return tmp_path / "x.sdp", port


@pytest.mark.parametrize(
    ("datagram", "to_report_port", "said"),
    [
        (None, False, "no packet came"),
        (bytes((0x80, 98)) + bytes(20), False, "payload type 98, not the 97 of the SDP"),
        (bytes((0x80, 33)) + bytes(20), False, "payload type 33"),
        (b"GET / HTTP/1.1\r\n", False, "not RTP"),
        (b"\x80\xc8\x00\x06" + bytes(24), True, "only the sender's reports"),
    ],
)
def test_receive_says_what_came_instead(
    datagram, to_report_port, said, described, tmp_path, capsys
):
    sdp, port = described
    done = Event()

    def send_it():
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
            while datagram is not None and not done.wait(0.02):
                udp.sendto(datagram, ("127.0.0.1", port + to_report_port))

    sending = Thread(target=send_it)
    sending.start()
    saved = tmp_path / "none.mkv"
    try:
        assert run(receive, "--sdp", sdp, "--seconds", 1.5, "--save", saved) == 1
    finally:
        done.set()
        sending.join()
    assert said in capsys.readouterr().err
    # An empty file would be no film.
    assert not saved.exists()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_whatever_ends_it_a_report_is_written(described, tmp_path, number):
    before = signal.getsignal(number)

    def end_it():
        eventually(lambda: signal.getsignal(number) is not before, "a handler")
        os.kill(os.getpid(), number)

    Thread(target=end_it).start()
    report = tmp_path / "r.json"
    assert run(receive, "--sdp", described[0], "--report", report, "--seconds", 200) == 1
    assert "no packet came" in report.read_text()


#: H.264 table A-1: of each level_idc the macroblocks a second and a picture, and kbit/s.
LEVELS = {
    10: (1485, 99, 64),
    11: (3000, 396, 192),
    12: (6000, 396, 384),
    13: (11_880, 396, 768),
    20: (11_880, 396, 2000),
    21: (19_800, 792, 4000),
    22: (20_250, 1620, 4000),
    30: (40_500, 1620, 10_000),
    31: (108_000, 3600, 14_000),
    32: (216_000, 5120, 20_000),
    40: (245_760, 8192, 20_000),
    42: (522_240, 8704, 50_000),
}


@pytest.mark.parametrize(
    ("size", "fps", "cap_kbps", "grown"),
    [
        ((640, 480), 30, 85, True),
        ((1280, 720), 60, 200, False),
        ((320, 240), 30, 85, False),
    ],
)
def test_the_sdp_offers_the_level_that_pictures_may_grow_to(size, fps, cap_kbps, grown, tmp_path):
    sdp = tmp_path / "x.sdp"
    width, height = size
    run(
        send,
        *("--video", "scene:static", "--to", f"127.0.0.1:{free_port()}", "--cap-kbps", cap_kbps),
        *("--fps", fps, "--size", f"{width}x{height}", "--seconds", 0.2, "--sdp", sdp),
    )
    offered = bytes.fromhex(sdp.read_text().split("profile-level-id=")[1][:6])
    rate, largest, kbps = LEVELS[offered[2]]
    blocks = -(-width // 16) * -(-height // 16)
    assert rate >= blocks * fps and largest >= blocks and kbps >= cap_kbps
    # A picture that stands is soon coded in its full size. Its parameter sets are within the offer.
    encoder = H264Encoder(
        width=width,
        height=height,
        fps=fps,
        cap_bps=cap_kbps * 1000,
        search="thorough",
        refresh_s=SLOW_REFRESH_S,
    )
    picture = empty_picture(width, height)
    picture.fill(128)
    across, down = np.arange(width), np.arange(height)[:, None]
    lines = (across % 32 == 0) | (down % 32 == 0)
    picture[:height] = 120 + 50 * np.sin(across / 23) + 40 * np.sin(down / 17) + 25 * lines
    sent = {}
    for number in range(100 if grown else 1):
        frame = VideoFrame(picture, CaptureStamp(number * 10**9 // fps, number, "still"))
        for unit in split_annex_b(encoder.encode(frame).data):
            if H264.nal_type(unit) == H264_SPS:
                sent[encoder.unit_size] = unit
    assert (size in sent) == (grown or encoder.coded_size == size)
    for sps in sent.values():
        assert sps[1] == offered[0] and sps[3] <= offered[2]
