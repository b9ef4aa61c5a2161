"""Invariants: a complete access unit equals the one that was sent, whatever the network did.

No octets from outside make a parser do anything but refuse.
"""

import contextlib

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rtp_packets import drain, feed, make_receiver, make_sender

from kontur_av.clock import NS_PER_MS
from kontur_av.errors import ConfigError, ProtocolError
from kontur_av.media import AccessUnit, CaptureStamp
from kontur_av.rtp.annex_b import join_annex_b, split_annex_b
from kontur_av.rtp.nal_depacketizer import NalDepacketizer
from kontur_av.rtp.nal_formats import H264, H265, NAL_FORMATS
from kontur_av.rtp.payload_opus import opus_samples
from kontur_av.rtp.rtcp import parse_rtcp
from kontur_av.rtp.sdp import parse_sdp, write_sdp
from kontur_av.rtp.wire import parse_rtp

# Bodies have no zeros, so they contain no start code.
BODY = st.integers(1, 6000).map(lambda n: bytes(1 + (n * i) % 255 for i in range(n)))


def pictures_of(codec, slice_, key, later, sets):
    """Return (codec, pictures): of one slice, with parameter sets, or of two slices."""
    head = BODY.map(lambda body: slice_ + body)
    picture = st.one_of(
        head.map(lambda unit: [unit]),
        head.map(lambda unit: [*sets, key + unit[1:]]),
        st.tuples(head, BODY).map(lambda both: [both[0], later + both[1]]),
    )
    return st.tuples(st.just(codec), st.lists(picture, min_size=2, max_size=12))


class Stream:
    """Send to the depacketizer what a network makes of the packets."""

    def __init__(self, codec_pictures, first_sequence, offset, max_payload_octets):
        codec, pictures = codec_pictures
        sender = make_sender(
            first_sequence=first_sequence,
            timestamp_offset=offset,
            max_payload_octets=max_payload_octets,
        )
        self.sent, self.packets = {}, []
        for number, units in enumerate(pictures):
            stamp = CaptureStamp(number * 33 * NS_PER_MS, number, "fuzz")
            data = join_annex_b(units)
            self.packets += sender.video_packets(AccessUnit(data, stamp, False, codec)).packets
            self.sent[sender.timestamp(stamp.capture_ns)] = data
        self.receiver = make_receiver()
        self.depacketizer = NalDepacketizer(NAL_FORMATS[codec])

    def deliver(self, packets):
        events = feed(self.receiver, packets, NS_PER_MS, NS_PER_MS)
        self.receiver.handle_timeout(10**12)
        for event in [*events, *drain(self.receiver)]:
            self.depacketizer.handle_packet(event)
        return list(iter(self.depacketizer.next_event, None))


SETS_264 = [b"\x67\x42\xc0\x1e\x11", b"\x68\xce\x3c\x80"]
SETS_265 = [b"\x40\x01\x0c", b"\x42\x01\x01", b"\x44\x01\xc1", b"\x4e\x01\x06"]
STREAM = st.builds(
    Stream,
    st.one_of(
        pictures_of("h264", b"\x41\x88", b"\x65", b"\x41\x22", SETS_264),
        pictures_of("h265", b"\x02\x01\x88", b"\x26", b"\x02\x01\x22", SETS_265),
    ),
    st.integers(0, 65_535),
    st.integers(0, 2**32 - 1),
    st.integers(64, 1400),
)


@settings(max_examples=120, deadline=None)
@given(STREAM, st.data())
def test_complete_access_units_equal_those_sent(stream, data):
    packets = stream.packets[:2]
    for packet in stream.packets[2:]:
        fate = data.draw(st.sampled_from(["come", "come", "come", "lost", "late"]))
        if fate == "come":
            packets.append(packet)
        elif fate == "late":
            packets.insert(max(2, len(packets) - data.draw(st.integers(0, 3))), packet)
    received = stream.deliver(packets)
    order = list(stream.sent)
    places = [order.index(unit.timestamp) for unit in received]
    assert places == sorted(set(places))
    for unit in received:
        if not unit.damaged and not unit.lost_before:
            assert unit.data == stream.sent[unit.timestamp]
    counts = stream.receiver.counts
    assert counts.rtp_packets == len(packets)
    # Packets lost at the end have no successor that could reveal the loss.
    assert counts.rtp_packets + counts.rtp_lost <= len(stream.packets)
    shown = 1 + max(stream.packets.index(packet) for packet in packets)
    assert counts.rtp_packets + counts.rtp_lost == shown


@pytest.mark.rule("7")
@settings(max_examples=300, deadline=None)
@given(st.binary(max_size=80))
def test_every_parser_refuses_or_accepts_any_octets(octets):
    for parse in (parse_rtp, parse_rtcp, H264.parse_payload, H265.parse_payload, opus_samples):
        with contextlib.suppress(ProtocolError):
            parse(octets)
    for unit in split_annex_b(octets):
        assert unit


LINE = st.sampled_from(
    [
        "c=IN IP4 1.2.3.4", "c=IN IP6 ::1", "c=IN IP4 name", "c=", "t=0 0", "m=video 9 RTP/AVP 96",
        "m=video x RTP/AVP 96 97", "m=audio 0 RTP/AVP 97", "m=audio 5004/2 RTP/AVP 111", "m=",
        "a=rtpmap:96 H264/90000", "a=rtpmap:97 opus/48000/2", "a=rtpmap:",
        "a=rtpmap:111 OPUS/48000/2",
        "a=fmtp:96 packetization-mode=2", "a=fmtp:96 sprop-parameter-sets=Z0LAHg==,aM48gA==",
        "a=fmtp:96 sprop-parameter-sets=!", "a=fmtp:96 sprop-parameter-sets=,", "a=rtcp:",
        "a=rtcp:7",
        "b=AS:85", "b=AS:many", "a=", "x", "=", "s=\u00e9",
    ]
)  # fmt: skip


@settings(max_examples=300, deadline=None)
@given(st.lists(st.one_of(LINE, LINE, st.text(max_size=60)), max_size=12), st.booleans())
def test_any_mixture_of_sdp_lines_is_refused_in_one_line_or_understood(lines, begun):
    head = ["c=IN IP4 127.0.0.1", "m=video 5004 RTP/AVP 96"] if begun else []
    try:
        stream = parse_sdp("\n".join(["v=0", *head, *lines]))
    except ConfigError as error:
        assert str(error) and "\n" not in str(error)
    else:
        assert parse_sdp(write_sdp(stream)).port == stream.port
