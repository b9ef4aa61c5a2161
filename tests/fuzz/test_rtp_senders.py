"""Invariants: however others packetize and mark a stream, the same pictures come out in order."""

import itertools
import struct

from hypothesis import given, settings
from hypothesis import strategies as st

from kontur_av.clock import NS_PER_MS
from kontur_av.rtp.annex_b import split_annex_b
from kontur_av.rtp.nal_formats import H264
from kontur_av.rtp.nal_payload import NalDepacketizer
from kontur_av.rtp.receiver import RtpReceiver
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
    return (
        struct.pack(
            "!BBHII",
            0x80,
            96 | bool(marker) << 7,
            sequence & 0xFFFF,
            timestamp & 0xFFFF_FFFF,
            ssrc,
        )
        + payload
    )


@settings(max_examples=300, deadline=None)
@given(st.lists(PICTURE, min_size=2, max_size=8), WAY, st.integers(0, 65_535))
def test_any_way_to_packetize_gives_the_same_pictures(pictures, way, first):
    if way["markers"].startswith("each"):
        # The first picture shows how the sender marks.
        pictures = [(pictures[0][0], [*pictures[0][1], b"\x41\x22\x07"]), *pictures[1:]]
    receiver = RtpReceiver(payload_type=96, clock_rate_hz=90_000)
    depacketizer = NalDepacketizer(H264)
    units = []
    for number, packet in enumerate(packets_of(pictures, way)):
        receiver.handle_packet(rtp(*packet, first + number), number)
        while (event := receiver.next_event()) is not None:
            depacketizer.handle_packet(event)
    depacketizer.handle_timeout(10**18)
    while (unit := depacketizer.next_event()) is not None:
        units.append(unit)
    assert [split_annex_b(unit.data) for unit in units] == [
        [*heads, *slices] for heads, slices in pictures
    ]
    assert not any(unit.damaged or unit.lost_before for unit in units)
    assert [unit.timestamp % PERIOD_TICKS for unit in units] == [0] * len(pictures)
    assert depacketizer.garbage == 0


@settings(max_examples=100, deadline=None)
@given(st.lists(PICTURE, min_size=4, max_size=12), WAY, st.sets(st.integers(0, 200), min_size=1))
def test_markers_amid_pictures_cost_one_picture_at_most(pictures, way, astray):
    way = way | {"markers": "last", "empty_packets": False, "heads_earlier": 0, "end_bit": True}
    depacketizer = NalDepacketizer(H264)
    receiver = RtpReceiver(payload_type=96, clock_rate_hz=90_000)
    for number, (payload, timestamp, marker) in enumerate(packets_of(pictures, way)):
        receiver.handle_packet(rtp(payload, timestamp, marker or number in astray, number), number)
        while (event := receiver.next_event()) is not None:
            depacketizer.handle_packet(event)
    depacketizer.handle_timeout(10**18)
    units = []
    while (unit := depacketizer.next_event()) is not None:
        units.append([one for one in split_annex_b(unit.data) if one[0] == 0x41])
    sent = [slices for _, slices in pictures]
    assert len([one for one in sent if one in units]) >= len(sent) - 1


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
    receiver = RtpReceiver(payload_type=96, clock_rate_hz=90_000)
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
    came = []
    while (event := receiver.next_event()) is not None:
        came.append(event.payload)
    assert came == sent
    assert receiver.counts.rtp_lost == 0


def report(timestamp, *, ntp=1 << 60, ssrc=7):
    return struct.pack("!BBHIQIII", 0x80, 200, 6, ssrc, ntp, timestamp & 0xFFFF_FFFF, 0, 0)


def begun(first=0, timestamp=0):
    receiver = RtpReceiver(payload_type=96, clock_rate_hz=90_000)
    for number in range(2):
        receiver.handle_packet(rtp(b"\x41", timestamp, True, first + number), number)
    return receiver


@given(st.binary(max_size=40), st.integers(0, 60))
def test_a_report_counts_whatever_is_behind_it(behind, words):
    receiver = begun()
    # Some cameras count the words of the whole datagram, or more.
    told = report(0)[:2] + struct.pack("!H", max(words, 6)) + report(0)[4:]
    assert receiver.handle_report(report(0) + behind, 5)
    assert receiver.handle_report(told, 5)
    assert receiver.capture_ns(0) is not None


@given(
    st.integers(-(2**31), 2**31 - 1),
    st.sampled_from([0, 1 << 60]),
    st.integers(0, 2**32 - 1),
)
def test_a_report_of_another_time_line_or_without_a_clock_dates_nothing(away, ntp, timestamp):
    receiver = begun(timestamp=timestamp)
    assert receiver.handle_report(report(timestamp + away, ntp=ntp), 5)
    dated = receiver.capture_ns(timestamp) is not None
    assert dated == (ntp != 0 and abs(away) <= 10 * 90_000)
    # The next good one does.
    receiver.handle_report(report(timestamp), 10)
    assert receiver.capture_ns(timestamp) is not None


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
            receiver.handle_report(report(timestamp), now_ns)
        if number not in lost:
            sound = rtp(head + bytes([1, number]), timestamp, number == 0, number)
            receiver.handle_packet(sound, now_ns, HERE)
        take()
    expected = [head + bytes([1, n]) for n in range(8, 70) if n not in lost]
    assert [one for one in played if 8 <= one[2] < 70] == expected
    steps = {round((b - a) / NS_PER_MS) for a, b in itertools.pairwise(stamps[8:])}
    assert all(step % (samples // 48) == 0 and step > 0 for step in steps)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 180), st.integers(0, 4), st.integers(0, 65_535))
def test_a_packet_of_each_picture_that_comes_late_is_waited_for(late_ms, which, first):
    receiver = RtpReceiver(payload_type=96, clock_rate_hz=90_000, most_reorder_ns=200 * NS_PER_MS)
    arrivals = []
    for picture in range(150):
        for part in range(5):
            late_ns = late_ms * NS_PER_MS if picture > 0 and part == which else 0
            sequence = picture * 5 + part
            packet = rtp(b"\x41\x88\x01", picture * PERIOD_TICKS, part == 4, first + sequence)
            arrivals.append((picture * PERIOD_NS + part * 1000 + late_ns, sequence, packet))
    came = []
    for now_ns, _, packet in sorted(arrivals):
        receiver.handle_packet(packet, now_ns)
        while (event := receiver.next_event()) is not None:
            came.append(event)
    assert receiver.counts.rtp_lost == receiver.counts.rtp_late == 0
    assert len(came) >= 149 * 5 - 30
    assert [event.lost_before for event in came] == [0] * len(came)
