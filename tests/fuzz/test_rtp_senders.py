"""Invariants: however others packetize and mark a stream, the same pictures come out in order."""

import itertools
import struct

from hypothesis import given, settings
from hypothesis import strategies as st
from rtp_packets import drain, feed, make_receiver

from kontur_av.clock import NS_PER_MS
from kontur_av.rtp.annex_b import split_annex_b
from kontur_av.rtp.nal_formats import H264
from kontur_av.rtp.nal_payload import NalDepacketizer
from kontur_av.rtp.wire import pack_rtp
from kontur_av.streams.voice_receiver import VoiceReceiver

PERIOD_TICKS, PERIOD_NS = 3000, 33_333_333
HERE, ELSEWHERE = ("192.0.2.1", 5004), ("192.0.2.2", 5004)
# Bodies have no zeros, so they contain no start code.
BODY = st.integers(1, 3000).map(lambda n: bytes(1 + (n * i) % 255 for i in range(n)))
HEADS = st.lists(st.sampled_from([b"\x09\xf0", b"\x06\x05\x01\x80", b"\x67\x42", b"\x68\xce"]))
PICTURE = st.builds(
    lambda heads, first, others: (
        heads,
        [b"\x41\x88" + first, *(b"\x41\x22" + one for one in others)],
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


LIFE = st.fixed_dictionaries(
    {
        "count": st.integers(2, 12),
        "anew": st.sampled_from(["source", "sequence", "timestamps"]),
        "step": st.integers(3000, 60_000),
        "pause_ms": st.sampled_from([0, 0, 700, 8000]),
    }
)


@settings(max_examples=150, deadline=None)
@given(st.lists(LIFE, min_size=2, max_size=6), st.booleans())
def test_a_sender_that_begins_anew_goes_on_and_a_stranger_stays_out(lives, strange):
    receiver = make_receiver()
    sent, now_ns, source, sequence, timestamp = [], 0, 0, 0, 0
    for life in lives:
        now_ns += life["pause_ms"] * NS_PER_MS
        if life["anew"] == "timestamps":
            timestamp += life["step"] * 100_000
        else:
            source += life["anew"] == "source"
            sequence += life["step"]
        for _ in range(life["count"]):
            now_ns += PERIOD_NS
            sequence, timestamp = sequence + 1, timestamp + PERIOD_TICKS
            sent.append(b"\x41" + struct.pack("!I", sequence))
            receiver.handle_packet(rtp(sent[-1], timestamp, True, sequence, source), now_ns, HERE)
            if strange and len(sent) > 2:
                packet = rtp(b"\x41no", len(sent), True, len(sent), 999)
                receiver.handle_packet(packet, now_ns + 1, ELSEWHERE)
    assert [event.payload for event in drain(receiver)] == sent
    assert receiver.counts.rtp_lost == 0


@settings(max_examples=60, deadline=None)
@given(
    st.sampled_from([1, 2, 3, 6]),
    st.sampled_from([(b"\x00", 480), (b"\x08", 960), (b"\x18", 2880)]),
    st.integers(0, 2**32 - 1),
    st.sets(st.integers(10, 60), max_size=5),
)
def test_sound_is_whole_and_dated_at_any_clock_of_its_timestamps(slow, packet, first, lost):
    head, samples = packet
    receiver = VoiceReceiver(payload_type=96)
    played, stamps = [], []

    def take():
        while (block := receiver.next_event()) is not None:
            if block.payload is not None:
                played.append(block.payload)
                stamps.append(receiver.capture_ns(block.timestamp))

    for number in range(80):
        now_ns = number * samples * NS_PER_MS // 48
        while (due_ns := receiver.poll_timeout()) is not None and due_ns <= now_ns:
            receiver.handle_timeout(due_ns)
            take()
        timestamp = first + number * samples // slow
        if number == 0:
            report = struct.pack("!BBHIQIII", 0x80, 200, 6, 7, 1 << 60, timestamp, 0, 0)
            receiver.handle_report(report, now_ns)
        if number not in lost:
            sound = rtp(head + bytes([1, number]), timestamp, number == 0, number)
            receiver.handle_packet(sound, now_ns, HERE)
        take()
    expected = [head + bytes([1, n]) for n in range(8, 70) if n not in lost]
    assert [one for one in played if 8 <= one[2] < 70] == expected
    steps = {round((b - a) / NS_PER_MS) for a, b in itertools.pairwise(stamps[8:])}
    assert all(step % (samples // 48) == 0 and step > 0 for step in steps)
