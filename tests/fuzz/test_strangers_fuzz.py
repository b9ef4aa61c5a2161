"""Whatever outsiders send or write, a parser understands it or refuses it with its own error."""

import contextlib
import resource
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory

import av
import numpy as np
import pytest
from common import first_seed, repeats
from mutated_octets import mutate
from rtp_packets import make_sender

from kontur_av.clock import NS_PER_MS, ManualClock
from kontur_av.errors import ConfigError, ProtocolError
from kontur_av.media import BLOCK_NS, AccessUnit, CaptureStamp, empty_picture
from kontur_av.rtp.annex_b import join_annex_b
from kontur_av.rtp.feedback import PictureLossListener
from kontur_av.rtp.rtcp import RtcpPsfbPacket, RtcpRrPacket
from kontur_av.sources.file import FileAudio, FileVideo
from kontur_av.sources.y4m import Y4mReader
from kontur_av.streams.video_receiver import VideoReceiver
from kontur_av.streams.voice_receiver import VoiceReceiver
from pipelines.partner import description
from pipelines.partner.ice_servers import servers_of_links
from pipelines.session.setup.setup_file import load_setup, setup_from_text
from pipelines.session.setup.setup_text import setup_toml

PICTURE = [b"\x67\x42\xc0\x1e\x11", b"\x68\xce\x3c\x80", b"\x65\x88" + bytes(range(1, 250))]


def packets(payload_type, *, picture):
    sender = make_sender(
        payload_type=payload_type,
        clock_rate_hz=90_000 if picture else 48_000,
        max_payload_octets=200,
        capture_time_id=3,
        picture_id=4,
        size=(640, 480),
    )
    made = []
    for number in range(4):
        stamp = CaptureStamp(number * 33 * NS_PER_MS, number, "unknown sender")
        if picture:
            made += sender.video_packets(AccessUnit(join_annex_b(PICTURE), stamp, True)).packets
        else:
            made += sender.audio_packets(b"\x78" + bytes(40), stamp).packets
    return [*made, sender.poll_report(200 * NS_PER_MS)]


class Taking:
    """What takes octets, and seeds of them."""

    inputs = 1000
    #: Some are whole, so that those that follow are judged by a healthy state.
    whole = 0.0

    def __init__(self, core, seeds, error=()):
        self._core, self.seeds, self._error, self._now_ns = core, seeds, error, 0


class Receiving(Taking):
    """A receiver that is given packets and reports in turn."""

    whole = 0.2

    def take(self, octets):
        self._now_ns += 3 * NS_PER_MS
        receiver = self._core
        receiver.handle_packet(octets, self._now_ns)
        receiver.handle_report(octets, self._now_ns)
        receiver.handle_timeout(self._now_ns)
        while receiver.next_event() is not None:
            pass
        receiver.poll_feedback(self._now_ns)


class Listening(Taking):
    """What a sender hears of its receivers."""

    whole = 0.2

    def take(self, octets):
        self._now_ns += 3 * NS_PER_MS
        self._core.handle_feedback(octets, self._now_ns)


class Parsing(Taking):
    """A parser of texts or octets with one error of its own."""

    def take(self, octets):
        with contextlib.suppress(self._error):
            self._core(octets)


def video():
    return Receiving(
        VideoReceiver(ssrc=9, capture_time_id=3, picture_id=4), packets(96, picture=True)
    )


def voice():
    receiver = VoiceReceiver(ssrc=9, payload_type=111, capture_time_id=3)
    return Receiving(receiver, packets(111, picture=False))


def listening():
    seeds = [bytes(RtcpRrPacket(9)) + bytes(RtcpPsfbPacket(1, 9, 7))]
    return Listening(PictureLossListener(ssrc=7), seeds)


def text_of(octets):
    return octets.decode(errors="replace")


def whip():
    transport = description.Transport(
        ufrag="user", password="password" * 3, fingerprints=(("sha-256", "AB:" * 31 + "AB"),)
    )
    lines = [
        description.wanted_line(kind, mid=kind, ssrc=number, sends=True, receives=True)
        for kind, number in (("audio", 1), ("video", 2))
    ]
    offers = [
        description.write_description(some, transport, session=1, cname="c", stream="s").encode()
        for some in (lines, lines[:1], lines[1:])
    ]
    fragment = description.write_candidates(transport, mid="0").encode()
    link = b'<turn:h:3478?transport=udp>; rel="ice-server"; username="u"; credential="c"'

    def parse(octets):
        text = text_of(octets)
        if text.startswith("v="):
            description.read_description(text, answers=False, ssrcs={"audio": 1, "video": 2})
        elif text.startswith("<"):
            servers_of_links([text])
        else:
            description.read_candidates(text)
        description.clean_candidates(text)

    return Parsing(parse, [*offers, fragment, fragment, link], ProtocolError)


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
    return Parsing(parse, [head + (b"FRAME\n" + bytes(12)) * 3])


#: Values in the place of others in a table.
ODD = [
    *("-1", "0", "1e300", "-0.0", "nan", "0x" + "f" * 600, "9" * 30, "true", "1979-05-27"),
    *('""', '"\\u0000.toml"', '"none"', '"1x1"', '"/"', "[]", "[[1, 2]]", "{}", "{a = 1}"),
    *("[" * 2000, '["static", "static"]'),
]


def toml():
    head, video, *tables = setup_toml(load_setup("spacejustin")).split("\n\n")
    name, cameras = (line for line in head.splitlines() if line.startswith(("name", "cameras")))
    seeds = []
    # A table each, so that an input costs little.
    for table in ["", head[head.index("radio =") :], *filter(str.strip, tables)]:
        text = f"{name}\n{cameras}\n{table}\n{video}\n"
        seeds.append(text)
        for line in text.splitlines():
            key, equals, _ = line.partition(" = ")
            seeds += [text.replace(line, f"{key} = {odd}") for odd in ODD if equals]
    seeds = [seed.encode() for seed in seeds]
    parsing = Parsing(lambda octets: setup_from_text(text_of(octets)), seeds, ConfigError)
    parsing.whole = 0.5
    return parsing


def sound(container, codec, rate_hz, layout="mono"):
    stream = container.add_stream(codec, rate=rate_hz, layout=layout)
    frame = av.AudioFrame(stream.format.name, layout, rate_hz * 30 // 1000)
    frame.sample_rate = rate_hz
    for plane in frame.planes:
        plane.update(bytes(np.arange(plane.buffer_size, dtype=np.uint8)))
    return stream, [frame]


def moving(container, codec, pixels):
    stream = container.add_stream(codec, rate=50)
    stream.width, stream.height, stream.pix_fmt = 32, 32, pixels
    frames = []
    for level in (40, 80, 120):
        frame = av.VideoFrame(32, 32, "yuv420p")
        for plane in frame.planes:
            plane.update(bytes([level]) * plane.buffer_size)
        frames.append(frame.reformat(format=pixels))
    return stream, frames


class Playing:
    """A media file as a source. It is played beyond its end, in bounded memory."""

    inputs = 200
    whole = 0.0
    #: The decoders and one resampler need less.
    MOST_MB = 100

    def __init__(self, name, open_source, into, writers):
        self._folder = TemporaryDirectory()
        self._path = Path(self._folder.name) / name
        self._open, self._into = open_source, into
        self.seeds = []
        for suffix, *described in writers:
            path = self._path.with_suffix(suffix)
            with av.open(str(path), "w") as container:
                streams = [add(container, *what) for add, *what in described]
                for stream, frames in streams:
                    for frame in (*frames, None):
                        container.mux(stream.encode(frame))
            self.seeds.append(path.read_bytes())
        self._most_kb = None

    def take(self, octets):
        self._path.write_bytes(octets)
        with contextlib.suppress(ConfigError):
            source = self._open(str(self._path))
            for _ in range(4):
                source.read(*self._into, BLOCK_NS)
            source.close()
        peak_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        self._most_kb = self._most_kb or peak_kb + self.MOST_MB * 1000
        assert peak_kb < self._most_kb


def wav():
    def opened(path):
        return FileAudio("unknown sender", ManualClock(), path)

    codecs = [("pcm_s16le", 8000), ("pcm_f32le", 44_100, "stereo"), ("adpcm_ms", 8000)]
    return Playing("a.wav", opened, (), [(".wav", (sound, *codec)) for codec in codecs])


def film():
    def opened(path):
        return FileVideo("unknown sender", 64, 48, 30, ManualClock(), path)

    writers = [
        (".avi", (moving, "mjpeg", "yuvj420p"), (sound, "pcm_s16le", 8000)),
        (".mkv", (moving, "libx264", "yuv420p"), (sound, "pcm_s16le", 8000)),
        (".mov", (moving, "mpeg4", "yuv420p"), (sound, "pcm_s16le", 8000)),
    ]
    return Playing("a.film", opened, (empty_picture(64, 48),), writers)


KINDS = [video, voice, listening, whip, y4m, toml, wav, film]


@pytest.mark.rule("7")
@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_any_octets_are_understood_or_refused(kind):
    parser, seed = kind(), first_seed()
    random = Random(seed)
    print(f"seed {seed}")
    for _ in range(repeats(parser.inputs)):
        octets = random.choice(parser.seeds)
        parser.take(octets if random.random() < parser.whole else mutate(random, octets))
