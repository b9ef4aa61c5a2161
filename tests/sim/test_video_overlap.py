"""A picture with a long coding time is not late: the previous one is sent meanwhile."""

from types import SimpleNamespace

import numpy as np
import pytest
from virtual_scene import bare_scene

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.codecs.h26x import H264Encoder
from kontur_av.media import CaptureStamp, VideoFrame
from kontur_av.rtp.sender import RtpIdentity
from kontur_av.streams.video_sender import VideoSender
from pipelines.report.model import CodingCosts
from pipelines.session.setup.table import VIDEO_PAYLOAD_OCTETS, VideoStream
from pipelines.virtual.streams import VideoSendProcess
from pipelines.virtual.workers import Agenda, Job

STREAM = VideoStream(name="video", cap_bps=512_000)
CHANNEL_BPS = 530_000
SECONDS = 8
#: From a picture's capture to the sender, and from its last octet to the screen.
COMING_NS, SHOWING_NS = NS_PER_MS // 2, 3 * NS_PER_MS


class Studio:
    """Encodes at once; the coding time is virtual."""

    def __init__(self, pictures):
        self.pictures = pictures
        self.encoded = []
        self.encoder = H264Encoder(
            width=STREAM.width, height=STREAM.height, fps=STREAM.fps, cap_bps=STREAM.cap_bps
        )

    def submit(self, job):
        number, coding, _ = job
        self.encoded.append(number)
        frame = VideoFrame(self.pictures[number], CaptureStamp(0, number, "test"))
        unit = self.encoder.encode(frame, coding)
        done = Job(None)
        done.set((unit.data, unit.keyframe))
        return done


class Channel:
    """Carries one octet after the other. arrived_ns: arrival of the last one of each picture."""

    freed_bps, contacts = 0, 1
    supervisor = SimpleNamespace(signal=True)
    sender = SimpleNamespace(waiting_octets=lambda level: 0)

    def __init__(self):
        self.free_ns = 0
        self.arrived_ns = []

    def handle_datagram(self, flow, packet, now_ns):
        octets_ns = len(packet) * 8 * NS_PER_S // CHANNEL_BPS
        self.free_ns = max(self.free_ns, now_ns) + octets_ns
        if flow == STREAM.name and packet[1] & 0x80:
            self.arrived_ns.append(self.free_ns)


# The period is 33 ms; sending a picture takes 32 of it.
@pytest.mark.parametrize("coding_ms", [14, 22])
def test_coding_and_sending_overlap(pictures, coding_ms):
    film = pictures("bikes.mp4", SECONDS * STREAM.fps)
    studio, channel, agenda = Studio(film), Channel(), Agenda()
    core = VideoSender(
        cap_bps=STREAM.cap_bps,
        fps=STREAM.fps,
        identity=RtpIdentity(1, 2, 3),
        cname="test",
        channel_bps=CHANNEL_BPS,
        max_payload_octets=VIDEO_PAYLOAD_OCTETS,
    )
    scene = bare_scene(agenda, SimpleNamespace(deadband="off"), CodingCosts(encode_ms=coding_ms))
    sender = VideoSendProcess(scene, STREAM, core, channel, studio)
    captured_ns = [number * NS_PER_S // STREAM.fps for number in range(len(film))]

    def come(number):
        stamp = CaptureStamp(captured_ns[number], number, "test")
        return lambda now_ns: sender.handle_picture(number, stamp, now_ns)

    for number, instant_ns in enumerate(captured_ns):
        agenda.at(instant_ns + COMING_NS, come(number))
    while agenda.next_ns < (SECONDS + 1) * NS_PER_S:
        agenda.do_next()

    # One after the other, 22 ms of coding would give 25 pictures a second.
    settled = [number for number in studio.encoded if number >= STREAM.fps]
    assert len(settled) >= 29.5 * (SECONDS - 1)
    latency_ms = [
        (arrived_ns + SHOWING_NS - captured_ns[number]) / NS_PER_MS
        for number, arrived_ns in zip(studio.encoded, channel.arrived_ns, strict=True)
        if number >= STREAM.fps
    ]
    assert np.percentile(latency_ms, 99) <= 60
