"""Invariants: however others packetize and mark a stream, the same pictures come out in order."""

import struct

from hypothesis import given, settings
from hypothesis import strategies as st
from rtp_packets import feed, make_receiver

from kontur_av.rtp.annex_b import split_annex_b
from kontur_av.rtp.nal_depacketizer import NalDepacketizer
from kontur_av.rtp.nal_formats import H264
from kontur_av.rtp.wire import pack_rtp

PERIOD_TICKS, PERIOD_NS = 3000, 33_333_333
# Bodies have no zeros, so they contain no start code.
BODY = st.integers(1, 3000).map(lambda n: bytes(1 + (n * i) % 255 for i in range(n)))
HEADS = st.lists(st.sampled_from([b"\x09\xf0", b"\x06\x05\x01\x80", b"\x67\x42", b"\x68\xce"]))
PICTURE = st.builds(
    lambda heads, first, others: (
        heads,
        [b"\x41\x88" + first, *(b"\x41\x22" + other for other in others)],
    ),
    HEADS,
    BODY,
    st.lists(BODY, max_size=3),
)
WAY = st.fixed_dictionaries(
    {
        "markers": st.sampled_from(["last", "each slice", "each unit", "none"]),
        "aggregate": st.booleans(),
        "most": st.integers(20, 1400),
        # FU-A also for what would fit: start and end in one.
        "always_parts": st.booleans(),
        "end_bit": st.booleans(),
        "start_code": st.sampled_from([b"", b"\0\0\1", b"\0\0\0\1"]),
        "zeros": st.integers(0, 3),
        "heads_earlier": st.sampled_from([0, 1, 1500]),
        "empty_packets": st.booleans(),
        # Some date each slice.
        "slice_ticks": st.sampled_from([0, 10]),
    }
)


def parts_of(unit, way):
    """Return the payloads that carry a NAL unit."""
    coded = way["start_code"] + unit + bytes(way["zeros"])
    if len(coded) <= way["most"] and not way["always_parts"]:
        return [coded]
    step, body = way["most"] - 2, coded[1:]
    cuts = range(0, max(len(body), 1), step)
    last = cuts[-1]
    return [
        bytes(
            (
                coded[0] & 0xE0 | 28,
                (0x80 if at == 0 else 0)
                | (0x40 if at == last and way["end_bit"] else 0)
                | coded[0] & 0x1F,
            )
        )
        + body[at : at + step]
        for at in cuts
    ]


def packets_of(pictures, way):
    """Return (payload, timestamp, marker) of each packet."""
    packets = []
    for number, (heads, slices) in enumerate(pictures):
        timestamp = number * PERIOD_TICKS
        early = way["heads_earlier"] if heads else 0
        marked_heads = way["markers"] == "each unit" or early
        if way["aggregate"] and len(heads) > 1:
            body = b"".join(struct.pack("!H", len(unit)) + unit for unit in heads)
            packets.append((b"\x78" + body + bytes(way["zeros"]), timestamp - early, marked_heads))
        else:
            for unit in heads:
                payloads = parts_of(unit, way)
                for payload in payloads:
                    marker = marked_heads and payload is payloads[-1]
                    packets.append((payload, timestamp - early, marker))
        for number_of_slice, unit in enumerate(slices):
            payloads = parts_of(unit, way)
            dated = timestamp + number_of_slice * way["slice_ticks"]
            last = way["markers"] == "last" and unit is slices[-1]
            for payload in payloads:
                marker = payload is payloads[-1] and (last or way["markers"].startswith("each"))
                packets.append((payload, dated, marker))
        if way["empty_packets"]:
            packets.append((b"", timestamp, False))
    return packets


def rtp(payload, timestamp, marker, sequence, ssrc=7):
    fields = {"payload_type": 96, "marker": bool(marker), "sequence": sequence & 0xFFFF}
    return pack_rtp(payload, timestamp=timestamp & 0xFFFF_FFFF, ssrc=ssrc, **fields)


def units_of(packets, first=0):
    """Return the depacketizer of (payload, timestamp, marker) packets, and its units."""
    datagrams = [rtp(*packet, first + number) for number, packet in enumerate(packets)]
    depacketizer = NalDepacketizer(H264)
    for event in feed(make_receiver(), datagrams):
        depacketizer.handle_packet(event)
    depacketizer.handle_timeout(10**18)
    return depacketizer, list(iter(depacketizer.next_event, None))


@settings(max_examples=300, deadline=None)
@given(st.lists(PICTURE, min_size=2, max_size=8), WAY, st.integers(0, 65_535))
def test_any_way_to_packetize_gives_the_same_pictures(pictures, way, first):
    if way["markers"].startswith("each"):
        # The first picture shows how the sender marks.
        pictures = [(pictures[0][0], [*pictures[0][1], b"\x41\x22\x07"]), *pictures[1:]]
    depacketizer, units = units_of(packets_of(pictures, way), first)
    assert [split_annex_b(unit.data) for unit in units] == [
        [*heads, *slices] for heads, slices in pictures
    ]
    assert not any(unit.damaged or unit.lost_before for unit in units)
    assert [unit.timestamp % PERIOD_TICKS for unit in units] == [0] * len(pictures)
    assert depacketizer.garbage == 0
