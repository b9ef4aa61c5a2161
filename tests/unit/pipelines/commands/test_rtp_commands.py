"""`send` and `receive` refuse the user's mistakes in one line, before anything starts."""

import argparse
import os
import signal
import socket
import wave
from threading import Event, Thread, Timer

import numpy as np
import pytest
from forged_streams import sps as forged_sps

from kontur_av.clock import MonotonicClock
from kontur_av.codecs.coding import SLOW_REFRESH_S
from kontur_av.codecs.h26x import H264Encoder
from kontur_av.errors import ConfigError
from kontur_av.media import CaptureStamp, VideoFrame, empty_picture
from kontur_av.rtp.annex_b import split_annex_b
from kontur_av.rtp.nal_formats import H264, H264_SPS
from kontur_av.rtp.sdp import parse_sdp
from kontur_av.rtp.wire import pack_rtp
from pipelines.commands import receive, send
from pipelines.recording.received_media import PictureOutput

SDP = "v=0\nc=IN IP4 127.0.0.1\nm=audio {port} RTP/AVP 97\na=rtpmap:97 opus/48000/2\n"
GOOD = ["--audio", "tone.wav", "--to", "127.0.0.1:5004", "--cap-kbps", "64"]


def run(command, *options) -> int:
    parser = argparse.ArgumentParser()
    command.add_arguments(parser)
    return command.run(parser.parse_args([str(option) for option in options]))


@pytest.mark.parametrize(
    ("options", "mend"),
    [
        (["--audio", "missing.wav"], "missing.wav"),
        (["--audio", "page"], "only a session has the source page"),
        (["--to", "127.0.0.1"], "HOST:PORT"),
        (["--to", "127.0.0.1:99999"], "65534"),
        (["--to", "no.such.host.invalid:5004"], "no.such.host"),
        (["--cap-kbps", "-3"], "above 0"),
        (["--cap-kbps", "6"], "a cap of 6 kbit/s: .* 6.24 to"),
        (["--cap-kbps", "64", "--channel-kbps", "60"], "lower the cap"),
        (["--seconds", "0"], "above 0"),
        (["--sdp", "/nowhere/x.sdp"], "--sdp"),
        (["--report", "/nowhere/x.json"], "--report"),
    ],
)
def test_send_refuses(options, mend, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with wave.open("tone.wav", "wb") as file:
        file.setparams((1, 2, 48_000, 0, "NONE", ""))
        file.writeframes(bytes(96_000))
    with pytest.raises(ConfigError, match=mend) as refused:
        run(send, *GOOD, *options)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("size", "mend"), [("640", "WIDTHxHEIGHT"), ("641x480", "even"), ("axb", "WIDTHxHEIGHT")]
)
def test_send_refuses_a_size(size, mend):
    with pytest.raises(ConfigError, match=mend):
        run(send, "--video", "x.mp4", *GOOD[2:], "--size", size)


def test_receive_refuses(tmp_path):
    with pytest.raises(ConfigError, match="cannot be read"):
        run(receive, "--sdp", tmp_path / "none.sdp")
    sdp = tmp_path / "x.sdp"
    sdp.write_text("hello")
    with pytest.raises(ConfigError, match="no SDP"):
        run(receive, "--sdp", sdp)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as busy:
        busy.bind(("127.0.0.1", 0))
        port = busy.getsockname()[1]
        sdp.write_text(SDP.format(port=port))
        with pytest.raises(ConfigError, match="cannot be opened"):
            run(receive, "--sdp", sdp)
    sdp.write_text(SDP.format(port=port))
    with pytest.raises(ConfigError, match="--save"):
        run(receive, "--sdp", sdp, "--seconds", 1, "--save", "/nowhere/x.mkv")


def test_receive_says_what_failed_when_nothing_comes(tmp_path, capsys):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    sdp = tmp_path / "x.sdp"
    sdp.write_text(SDP.format(port=port))
    saved = tmp_path / "none.mkv"
    assert run(receive, "--sdp", sdp, "--seconds", 0.2, "--save", saved) == 1
    assert "no packet came" in capsys.readouterr().err
    # An empty file would be no film.
    assert not saved.exists()


@pytest.mark.parametrize(
    ("second_octet", "to_report_port", "said"),
    [
        (98, False, "payload type 98, not the 97 of the SDP"),
        (33, False, "payload type 33"),
        (None, False, "not RTP"),
        (200, True, "only the sender's reports"),
    ],
)
def test_receive_says_what_came_instead(second_octet, to_report_port, said, tmp_path, capsys):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1] & ~1
    sdp = tmp_path / "x.sdp"
    sdp.write_text(SDP.format(port=port))
    datagram = b"GET / HTTP/1.1\r\n"
    if to_report_port:
        datagram = b"\x80\xc8\x00\x06" + bytes(24)
    elif second_octet is not None:
        datagram = bytes((0x80, second_octet)) + bytes(20)
    done = Event()

    def send_it():
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
            while not done.wait(0.02):
                udp.sendto(datagram, ("127.0.0.1", port + to_report_port))

    sending = Thread(target=send_it)
    sending.start()
    try:
        assert run(receive, "--sdp", sdp, "--seconds", 0.4) == 1
    finally:
        done.set()
        sending.join()
    assert said in capsys.readouterr().err


@pytest.mark.parametrize(
    ("units", "said"),
    [
        ([b"\x41\x88abcd"], "no SPS and no PPS came"),
        ([b"\x67\x42\xc0\x1e", b"\x65\x88abcd"], ": no PPS came"),
        ([forged_sps("h264", 320, 240), b"\x68\xce", b"\x65\x88abcd"], ""),
        ([forged_sps("h264", 8192, 8192), b"\x68\xce", b"\x65\x88abcd"], "too much memory"),
    ],
)
def test_receive_says_which_parameter_sets_never_came(units, said):
    stream = "v=0\nm=video 5004 RTP/AVP 96\na=rtpmap:96 H264/90000\n"
    output = PictureOutput(parse_sdp(stream), MonotonicClock(), [])
    for number, unit in enumerate(units * 3):
        last = number % len(units) == len(units) - 1
        timestamp = number // len(units) * 3000
        packet = pack_rtp(
            unit, payload_type=96, marker=last, sequence=number, timestamp=timestamp, ssrc=1
        )
        output.receiver.handle_packet(packet, number)
        output.drain()
    assert (output.decoded, said in output.missing()) == (0, True)
    assert bool(output.missing()) == bool(said)


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
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as there:
        there.bind(("127.0.0.1", 0))
        to = f"127.0.0.1:{there.getsockname()[1]}"
        width, height = size
        run(
            send,
            *("--video", "scene:static", "--to", to, "--cap-kbps", cap_kbps, "--fps", fps),
            *("--size", f"{width}x{height}", "--seconds", 0.2, "--sdp", sdp),
        )
    text = sdp.read_text()
    offered = bytes.fromhex(text.split("profile-level-id=")[1][:6])
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


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_whatever_ends_it_a_report_is_written(tmp_path, number):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        udp.bind(("127.0.0.1", 0))
        port = udp.getsockname()[1] & ~1
    (tmp_path / "s.sdp").write_text(SDP.format(port=port))
    timer = Timer(0.3, os.kill, (os.getpid(), number))
    timer.start()
    report = tmp_path / "r.json"
    assert run(receive, "--sdp", tmp_path / "s.sdp", "--report", report, "--seconds", 20) == 1
    assert "no packet came" in report.read_text()
