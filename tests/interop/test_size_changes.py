"""A stream whose coded size grows and shrinks, received by plain GStreamer and FFmpeg."""

import re
import socket
import subprocess
import time
from itertools import groupby
from pathlib import Path

import numpy as np
import pytest
from common import TIMEOUT_S, eventually, free_port, psnr_db
from programs import needs
from rtp_packets import PromptSender

from kontur_av.codecs.h26x import H264Encoder
from kontur_av.media import VIDEO_CLOCK_HZ, VIDEO_PAYLOAD_TYPE, CaptureStamp, VideoFrame
from kontur_av.rtp.sdp import StreamDescription, write_sdp

pytestmark = pytest.mark.interop

WIDTH, HEIGHT, FPS = 640, 480, 30
#: The film stands until the first number, moves until the second, and stands again.
STANDS, MOVES, ALL = 150, 210, 240
#: A receiver ends after so many pictures; so a few may be lost before it is ready.
RECEIVED = ALL - 15
SMALL, LARGE = (384, 288), (640, 480)


def scene(number: int) -> np.ndarray:
    """Return waves and thin lines that move and stand: shape (720, 640), I420."""
    shift = 6 * min(max(number - STANDS, 0), MOVES - STANDS)
    picture = np.full((HEIGHT * 3 // 2, WIDTH), 128, np.uint8)
    across, down = np.arange(WIDTH) + shift, np.arange(HEIGHT)[:, None] + shift
    waves = 120 + 50 * np.sin(across / 23) + 40 * np.sin(down / 17)
    lines = (across % 32 == 0) | (down % 32 == 0)
    picture[:HEIGHT] = waves + 25 * lines
    return picture


def likeness_db(picture: np.ndarray, number: int) -> float:
    return psnr_db(picture[:HEIGHT], scene(number)[:HEIGHT])


@pytest.fixture(scope="module")
def stream():
    """The packets of each picture, and the size in which each was coded."""
    encoder = H264Encoder(width=WIDTH, height=HEIGHT, fps=FPS, cap_bps=85_000, refresh_s=20.0)
    sender = PromptSender(
        payload_type=VIDEO_PAYLOAD_TYPE,
        clock_rate_hz=VIDEO_CLOCK_HZ,
        ssrc=1,
        first_sequence=0,
        timestamp_offset=0,
        cname="test",
    )
    packets, sizes = [], []
    for number in range(ALL):
        stamp = CaptureStamp(number * 1_000_000_000 // FPS, number, "test")
        unit = encoder.encode(VideoFrame(scene(number), stamp))
        packets.append(sender.video_packets(unit).packets)
        sizes.append(encoder.unit_size)
    return packets, sizes


def receiver(name: str, port: int, sdp, raw) -> list[object]:
    """The command of a receiver that ends by itself, and writes I420 pictures of one size."""
    if name == "ffmpeg":
        return [
            *("ffmpeg", "-v", "error", "-protocol_whitelist", "file,udp,rtp"),
            *("-buffer_size", 1_000_000, "-i", sdp),
            *("-frames:v", RECEIVED, "-fps_mode", "passthrough", "-vf", f"scale={WIDTH}:{HEIGHT}"),
            *("-f", "rawvideo", "-pix_fmt", "yuv420p", raw),
        ]
    caps = "application/x-rtp,media=video,clock-rate=90000,encoding-name=H264,payload=96"
    pipeline = (
        f"udpsrc port={port} buffer-size=1000000 caps={caps} ! "
        "rtph264depay ! avdec_h264 ! videoscale ! videoconvert ! "
        f"video/x-raw,format=I420,width={WIDTH},height={HEIGHT} ! identity eos-after={RECEIVED} ! "
        f"filesink location={raw}"
    )
    return ["gst-launch-1.0", "-q", *pipeline.split()]


@pytest.mark.parametrize("name", ["gst-launch-1.0", "ffmpeg"])
def test_it_goes_on_through_each_size(name, stream, tmp_path):
    needs(name)
    packets, sizes = stream
    assert [size for size, _ in groupby(sizes)] == [SMALL, LARGE, SMALL]
    port, sdp, raw = free_port(), tmp_path / "x.sdp", tmp_path / "x.yuv"
    description = StreamDescription(
        kind="video", host="127.0.0.1", port=port, payload_type=VIDEO_PAYLOAD_TYPE
    )
    sdp.write_text(write_sdp(description))
    command = [str(word) for word in receiver(name, port, sdp, raw)]
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT) as process,
    ):
        bound = Path("/proc/net/udp")
        eventually(lambda: f":{port:04X} " in bound.read_text() or process.poll(), "the receiver")

        def waiting_octets():
            found = re.search(rf":{port:04X} \S+ \S+ \w+:(\w+)", bound.read_text())
            return int(found[1], 16) if found else 0

        for picture in packets:
            for packet in picture:
                sender.sendto(packet, ("127.0.0.1", port))
            # Faster than real time, but no faster than a decoder, also one that stalls.
            time.sleep(0.008)
            eventually(lambda: waiting_octets() < 30_000, "the decoder")
        try:
            output, _ = process.communicate(timeout=TIMEOUT_S)
        finally:
            process.kill()
    assert process.returncode == 0, output
    pictures = np.fromfile(raw, np.uint8).reshape(-1, HEIGHT * 3 // 2, WIDTH)
    # GStreamer leaves out the picture at which it ends.
    assert RECEIVED - 1 <= len(pictures) <= RECEIVED
    # Pictures that were lost before it was ready are the first ones.
    losses = range(ALL - RECEIVED + 1)
    lost = max(losses, key=lambda lost: likeness_db(pictures[MOVES], MOVES + lost))
    quality = [likeness_db(picture, at + lost) for at, picture in enumerate(pictures)]
    # A key picture in the larger size is coarse.
    assert min(quality) > 27
    assert np.mean(quality) > 36
