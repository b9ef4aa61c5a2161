"""Whole ends of a stream: bad input is refused, and errors reach the caller."""

import socket
import struct
from fractions import Fraction

import av as pyav
import numpy as np
import pytest
from janus_room import free_port
from rtp_packets import PromptSender

import kontur_av as av
from kontur_av.media import BLOCK_NS, CaptureStamp, Quality, VideoFrame
from kontur_av.rtp.annex_b import split_annex_b
from kontur_av.rtp.nal_formats import H264
from kontur_av.streams import ends

GREY = np.full((96, 128, 3), 90, np.uint8)


@pytest.mark.parametrize(
    "to",
    [
        *("127.0.0.1", "127.0.0.1:x", ":5004", "127.0.0.1:65535", "127.0.0.1:0"),
        *("localhost:5004", "192.0.2.256:5004", "127.0.0.1:\u00b2"),
    ],
)
def test_a_wrong_address_is_refused(to):
    for sender in (av.PictureSender, av.SoundSender):
        with pytest.raises(av.ConfigError, match="HOST:PORT"):
            sender(to, cap_bps=85_000)


def test_what_is_no_picture_or_no_block_is_refused():
    with av.PictureSender("127.0.0.1:9", cap_bps=85_000) as end:
        for wrong in (GREY[:, :, 0], GREY.astype(np.float32)):
            with pytest.raises(av.ConfigError, match="uint8, RGB"):
                end.send(wrong)
        with pytest.raises(av.ConfigError, match="multiple of 4"):
            end.send(GREY[:95])
        end.send(GREY)
        with pytest.raises(av.ConfigError, match="after one of"):
            end.send(GREY[:64])
    with pytest.raises(av.ConfigError, match="closed"):
        end.send(GREY)
    with (
        av.SoundSender("127.0.0.1:9", cap_bps=24_000) as end,
        pytest.raises(av.ConfigError, match="int16"),
    ):
        end.send(np.zeros(480, np.int16))


def test_what_cannot_work_is_refused_in_one_line(tmp_path):
    for fps in (0, 121):
        with pytest.raises(av.ConfigError, match=f"fps {fps}"):
            av.PictureSender("127.0.0.1:9", cap_bps=85_000, fps=fps)
    with pytest.raises(av.ConfigError, match="codec 'hevc'"):
        av.PictureSender("127.0.0.1:9", cap_bps=85_000, codec="hevc")
    with pytest.raises(av.ConfigError, match="cannot be written"):
        av.SoundSender("127.0.0.1:9", cap_bps=24_000, sdp=tmp_path / "none" / "s.sdp")


def test_an_end_that_has_sent_nothing_says_so_and_takes_any_port():
    for to in ("127.0.0.1:1", "[::1]:65534"):
        with av.PictureSender(to, cap_bps=85_000) as end:
            assert (end.counts.frames_captured, end.largest_bps) == (0, 0)
        end.close()


def test_a_cap_that_cannot_be_kept_is_refused():
    with av.PictureSender("127.0.0.1:9", cap_bps=100) as end, pytest.raises(av.ConfigError):
        end.send(GREY)


def test_what_ends_the_thread_reaches_the_caller(monkeypatch):
    def fail(*_):
        raise RuntimeError("out of order")

    monkeypatch.setattr(ends.UdpSender, "exchange", fail)
    with pytest.raises(RuntimeError, match="out of order"):  # noqa: SIM117
        with av.PictureSender("127.0.0.1:9", cap_bps=85_000) as end:
            for _ in range(100):
                end.send(GREY)


def test_an_sdp_that_is_absent_or_whose_port_is_taken_is_refused(tmp_path):
    with pytest.raises(av.ConfigError, match="cannot be read"):
        av.StreamReceiver(tmp_path / "none.sdp")
    port, sdp = free_port(), tmp_path / "s.sdp"
    stream = av.StreamDescription(kind="video", host="127.0.0.1", port=port, payload_type=96)
    sdp.write_text(av.write_sdp(stream))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", port))
        with pytest.raises(av.ConfigError, match="cannot be opened"):
            av.StreamReceiver(sdp)


def test_an_undated_picture_after_a_loss_is_called_damaged(tmp_path):
    port, sdp = free_port(), tmp_path / "s.sdp"
    stream = av.StreamDescription(kind="video", host="127.0.0.1", port=port, payload_type=96)
    sdp.write_text(av.write_sdp(stream))
    encoder = av.H264Encoder(width=128, height=96, fps=50, cap_bps=300_000)
    sender = PromptSender(
        payload_type=96,
        clock_rate_hz=90_000,
        ssrc=1,
        first_sequence=0,
        timestamp_offset=0,
        cname="test",
    )
    with (
        av.StreamReceiver(sdp) as pictures,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out,
    ):
        for number in range(6):
            picture = np.full((144, 128), 60 + 10 * number, np.uint8)
            frame = VideoFrame(picture, CaptureStamp(number * BLOCK_NS, number, "test"))
            for packet in sender.video_packets(encoder.encode(frame)).packets:
                if number != 4:
                    out.sendto(packet, ("127.0.0.1", port))
        seen = []
        for one in pictures:
            seen.append((one.age_ms, one.quality))
            if one.quality is not Quality.FRESH:
                break
    assert seen[-1] == (None, Quality.DAMAGED)


def test_a_stream_with_b_pictures_ends_with_its_last_picture(tmp_path):
    port, sdp = free_port(), tmp_path / "s.sdp"
    stream = av.StreamDescription(kind="video", host="127.0.0.1", port=port, payload_type=96)
    sdp.write_text(av.write_sdp(stream))
    codec = pyav.CodecContext.create("libx264", "w")
    codec.width, codec.height, codec.pix_fmt = 128, 96, "yuv420p"
    codec.time_base, codec.framerate = Fraction(1, 25), Fraction(25)
    codec.options = {"x264-params": "bframes=2:b-adapt=0"}
    coded = []
    for number in range(8):
        frame = pyav.VideoFrame.from_ndarray(
            np.full((144, 128), 60 + 10 * number, np.uint8), "yuv420p"
        )
        frame.pts = number
        coded += codec.encode(frame)
    coded += codec.encode(None)
    sequence = 0
    with (
        av.StreamReceiver(sdp) as pictures,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out,
    ):
        for one in coded:
            for payload in H264.packetize(split_annex_b(bytes(one))):
                header = struct.pack("!BBHII", 0x80, 96, sequence, one.pts * 3600, 7)
                out.sendto(header + payload, ("127.0.0.1", port))
                sequence += 1
        goodbye = struct.pack("!BBHIBBHI", 0x80, 201, 1, 7, 0x81, 203, 1, 7)
        out.sendto(goodbye, ("127.0.0.1", port + 1))
        *_, last = pictures
    # Luma 130 in RGB; the picture before it has 120, 121 in RGB.
    assert abs(last.data.mean() - 133) < 5
