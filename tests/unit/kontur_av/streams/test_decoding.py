"""What comes out of a stream that others send: damage without a date, and B pictures."""

from fractions import Fraction

import av as pyav
import numpy as np
from rtp_packets import make_sender

from kontur_av.clock import NS_PER_MS, NS_PER_S, ManualClock
from kontur_av.media import BLOCK_NS, AccessUnit, CaptureStamp
from kontur_av.rtp.sdp import StreamDescription
from kontur_av.streams.decoding import PictureDecoding

STREAM = StreamDescription(kind="video", host="127.0.0.1", port=5004, payload_type=96)


def coded(count, **options):
    """Return coded pictures, each brighter, and their numbers."""
    codec = pyav.CodecContext.create("libx264", "w")
    codec.width, codec.height, codec.pix_fmt = 128, 96, "yuv420p"
    codec.time_base, codec.framerate = Fraction(1, 25), Fraction(25)
    codec.options = options
    packets = []
    for number in range(count):
        luma = np.full((144, 128), 60 + 10 * number, np.uint8)
        picture = pyav.VideoFrame.from_ndarray(luma, "yuv420p")
        picture.pts = number
        packets += codec.encode(picture)
    return [(bytes(packet), packet.pts) for packet in [*packets, *codec.encode(None)]]


def decoded(units, *, lost=()):
    """Return the decoding, and (luma, stamp, whether it is damaged) of each picture."""
    rtp, decoding, seen = make_sender(), PictureDecoding(STREAM, ManualClock(0)), []

    def note(pictures):
        for picture, stamp in pictures:
            seen.append((picture.to_i420()[0, 0], stamp, decoding.receiver.shows_damage))

    for number, (data, place) in enumerate(units):
        unit = AccessUnit(data, CaptureStamp(place * BLOCK_NS, place, "test"), False)
        now_ns = number * BLOCK_NS
        for packet in rtp.video_packets(unit).packets:
            if number not in lost:
                decoding.receiver.handle_packet(packet, now_ns)
        decoding.receiver.handle_timeout(now_ns + 15 * NS_PER_MS)
        for _, pictures in decoding.units():
            note(pictures)
    decoding.receiver.handle_timeout(100 * NS_PER_S)
    for _, pictures in decoding.units():
        note(pictures)
    return decoding, seen, note


def test_an_undated_picture_after_a_loss_is_damaged():
    _, seen, _ = decoded(coded(7, tune="zerolatency"), lost={4})
    assert [(stamp, damaged) for _, stamp, damaged in seen] == [
        *[(None, False)] * 4, *[(None, True)] * 2
    ]  # fmt: skip


def test_a_stream_with_b_pictures_ends_with_its_last_picture():
    parameters = {"x264-params": "bframes=2:b-adapt=0"}
    decoding, seen, note = decoded(coded(8, **parameters))
    note(decoding.rest())
    lumas = [int(luma) for luma, *_ in seen]
    assert len(lumas) == 8
    assert all(abs(luma - 60 - 10 * number) < 4 for number, luma in enumerate(lumas))
