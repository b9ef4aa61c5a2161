"""Streams marked and packetized as others do it: our pictures are those that FFmpeg decodes."""

import hashlib
import shutil
import struct
import subprocess

import pytest

from kontur_av.codecs.h26x import H264Decoder
from kontur_av.rtp.annex_b import split_annex_b
from kontur_av.rtp.nal_formats import H264
from kontur_av.streams.video_receiver import VideoReceiver

pytestmark = pytest.mark.interop

HERE = ("192.0.2.1", 5004)
PERIOD_NS = 40_000_000


@pytest.fixture(scope="module")
def film(tmp_path_factory):
    """Return the NAL units of 50 pictures with four slices each, and FFmpeg's pictures of them."""
    if shutil.which("ffmpeg") is None:
        pytest.skip("ffmpeg is missing: install it")
    path = tmp_path_factory.mktemp("film") / "film.h264"
    options = "-pix_fmt yuv420p -c:v libx264 -preset ultrafast -tune zerolatency -bf 0 -g 10"
    subprocess.run(
        [
            *("ffmpeg", "-v", "error", "-f", "lavfi", "-i", "testsrc2=s=320x240:r=25:d=2"),
            *options.split(),
            *("-x264-params", "slices=4:aud=1", path),
        ],
        check=True,
    )
    raw = subprocess.run(
        ["ffmpeg", "-v", "error", "-i", path, "-f", "rawvideo", "-"],
        check=True,
        capture_output=True,
    ).stdout
    size = 320 * 240 * 3 // 2
    pictures = [hashlib.md5(raw[at : at + size]).digest() for at in range(0, len(raw), size)]
    assert len(pictures) == 50
    return split_annex_b(path.read_bytes()), pictures


@pytest.mark.parametrize("marked", ["slice", "unit", "nothing"])
@pytest.mark.parametrize("lasting", [True, False])
def test_our_pictures_are_those_of_ffmpeg(film, marked, lasting):
    units, expected = film
    receiver, decoder = VideoReceiver(ssrc=1), H264Decoder(reordered=True)
    found, picture, sequence, life = [], 0, 0, 0

    def take():
        while (unit := receiver.next_event()) is not None:
            shown = decoder.decode(unit.data, unit.timestamp)
            found.extend(hashlib.md5(one.to_i420().tobytes()).digest() for one in shown)

    for unit in units:
        kind = H264.nal_type(unit)
        if kind == 9:
            picture += 1
            if picture % 10 == 1 and not lasting:
                # A camera that begins anew with each group of pictures.
                life, sequence = life + 1, 7000 * life
        payloads = H264.packetize([unit], 500)
        for payload in payloads:
            last = payload is payloads[-1]
            marker = last and (marked == "unit" or (marked == "slice" and kind in (1, 5)))
            header = struct.pack(
                "!BBHII", 0x80, 96 | marker << 7, sequence & 0xFFFF, picture * 3600, life
            )
            sequence += 1
            receiver.handle_packet(header + payload, picture * PERIOD_NS, HERE)
            take()
    receiver.handle_timeout(60 * PERIOD_NS)
    receiver.handle_timeout(10**12)
    take()
    assert found == expected
    assert receiver.counts.frames_damaged == 0
