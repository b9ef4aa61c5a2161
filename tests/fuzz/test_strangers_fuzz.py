"""Whatever strangers send or write, a parser understands it or refuses it with its own error.

`KONTUR_FUZZ_STRANGERS=1000000 pytest tests/fuzz/test_strangers_fuzz.py` runs that many inputs of
each kind, and `KONTUR_FUZZ_SEED` chooses others.
"""

import contextlib
import os
from random import Random

import pytest
from aiortc.rtp import RtcpPsfbPacket, RtcpRrPacket
from mutated_octets import mutate
from recordings import Step, scanned, write
from rtp_packets import PromptSender

from kontur_av.clock import NS_PER_MS
from kontur_av.errors import ConfigError, ProtocolError
from kontur_av.media import AccessUnit, CaptureStamp
from kontur_av.rtp.feedback import PictureLossListener
from kontur_av.rtp.payload_h264 import join_annex_b
from kontur_av.rtp.sdp import StreamDescription, parse_sdp, write_sdp
from kontur_av.sources.y4m import Y4mReader
from kontur_av.streams.video_receiver import VideoReceiver
from kontur_av.streams.voice_receiver import VoiceReceiver
from pipelines.partner.description import (
    MediaLine,
    Transport,
    read_candidates,
    read_description,
    write_candidates,
    write_description,
)
from pipelines.session.setup.setup_file import load_setup, setup_from_text
from pipelines.session.setup.setup_text import setup_toml

INPUTS = int(os.environ.get("KONTUR_FUZZ_STRANGERS", "1000"))
SEED = int(os.environ.get("KONTUR_FUZZ_SEED", "0"))


def packets(payload_type, *, picture):
    sender = PromptSender(
        payload_type=payload_type,
        clock_rate_hz=90_000 if picture else 48_000,
        ssrc=7,
        first_sequence=65_530,
        timestamp_offset=2**32 - 9_000,
        cname="stranger",
        max_payload_octets=200,
        capture_time_id=3,
    )
    made = []
    for number in range(4):
        stamp = CaptureStamp(number * 33 * NS_PER_MS, number, "stranger")
        if picture:
            units = [
                b"\x67\x42\xc0\x1e\x11",
                b"\x68\xce\x3c\x80",
                b"\x65\x88" + bytes(range(1, 250)),
            ]
            made += sender.video_packets(AccessUnit(join_annex_b(units), stamp, True)).packets
        else:
            made += sender.audio_packets(b"\x78" + bytes(40), stamp).packets
    return made, [sender.poll_report(200 * NS_PER_MS)]


class Receiving:
    """A receiver that is given packets and reports in turn."""

    def __init__(self, receiver, seeds):
        self._receiver, self.seeds, self._now_ns = receiver, seeds, 0

    def take(self, octets):
        self._now_ns += 3 * NS_PER_MS
        receiver = self._receiver
        receiver.handle_packet(octets, self._now_ns)
        receiver.handle_report(octets, self._now_ns)
        receiver.handle_timeout(self._now_ns)
        while receiver.next_event() is not None:
            pass
        receiver.poll_feedback(self._now_ns)


def video():
    rtp, rtcp = packets(96, picture=True)
    return Receiving(VideoReceiver(ssrc=9, capture_time_id=3), rtp + rtcp)


def voice():
    rtp, rtcp = packets(111, picture=False)
    return Receiving(VoiceReceiver(ssrc=9, payload_type=111, capture_time_id=3), rtp + rtcp)


class Listening:
    """What a sender hears of its receivers."""

    def __init__(self):
        self._listener, self._now_ns = PictureLossListener(ssrc=7), 0
        self.seeds = [bytes(RtcpRrPacket(9)) + bytes(RtcpPsfbPacket(1, 9, 7))]

    def take(self, octets):
        self._now_ns += 3 * NS_PER_MS
        self._listener.handle_feedback(octets, self._now_ns)


class Parsing:
    """A parser of texts or octets with one error of its own."""

    def __init__(self, parse, seeds, error):
        self._parse, self.seeds, self._error = parse, seeds, error

    def take(self, octets):
        with contextlib.suppress(self._error):
            self._parse(octets)


def text_of(octets):
    return octets.decode(errors="replace")


def sdp():
    video = StreamDescription(
        kind="video", host="127.0.0.1", port=5004, payload_type=96, feedback=True, capture_time_id=3
    )
    audio = StreamDescription(
        kind="audio", host="239.1.2.3", port=5006, payload_type=111, bandwidth_bps=8000
    )
    seeds = [write_sdp(video).encode(), write_sdp(audio).encode()]
    return Parsing(lambda octets: parse_sdp(text_of(octets)), seeds, ConfigError)


def whip():
    transport = Transport(
        ufrag="user", password="password" * 3, fingerprints=(("sha-256", "AB:" * 31 + "AB"),)
    )
    lines = [
        MediaLine(
            mid=kind,
            kind=kind,
            sends=True,
            receives=True,
            payload_type=number,
            extensions={},
            feedback=frozenset(["nack pli"]),
            ssrc=number,
        )
        for kind, number in (("audio", 111), ("video", 96))
    ]
    offer = write_description(lines, transport, session=1, cname="c", stream="s")
    seeds = [offer.encode(), write_candidates(transport, mid="0").encode()]

    def parse(octets):
        with contextlib.suppress(ProtocolError):
            read_description(text_of(octets), answers=False, ssrcs={"audio": 1, "video": 2})
        read_candidates(text_of(octets))

    return Parsing(parse, seeds, ProtocolError)


def mcap():
    script = [Step(210_000_000, count % 5, 0, bytes([count]) * 12) for count in range(14)]
    return Parsing(scanned, [write(script).octets], ProtocolError)


def y4m():
    def parse(octets):
        reader = Y4mReader()
        while octets:
            view = reader.write_view()
            count = min(len(view), len(octets))
            view[:count] = octets[:count]
            octets = octets[count:]
            reader.handle_written(count)
            while reader.next_event() is not None:
                pass
        reader.handle_end()

    head = b"YUV4MPEG2 W4 H2 F30:1 Ip A1:1 C420jpeg XCOLORRANGE=FULL\n"
    return Parsing(parse, [head + (b"FRAME\n" + bytes(12)) * 3], ())


def toml():
    seeds = [setup_toml(load_setup(name)).encode() for name in ("spacejustin", "taskboard")]
    return Parsing(lambda octets: setup_from_text(text_of(octets)), seeds, ConfigError)


@pytest.mark.parametrize("kind", [video, voice, Listening, sdp, whip, mcap, y4m, toml])
def test_any_octets_are_understood_or_refused(kind):
    random, parser = Random(SEED), kind()
    for _ in range(INPUTS):
        octets = random.choice(parser.seeds)
        # Some are whole, so that those that follow are judged by a healthy state.
        parser.take(octets if random.random() < 0.2 else mutate(random, octets))
