"""Frames and packet zones octet by octet, at their edges (CCSDS 732.0-B-5, link-format.md)."""

from binascii import crc_hqx
from collections import deque
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from telepresence.link.flows import Level, packet_flow, rtcp_flow, tmtc_flow, video_flow
from telepresence.link.frame import FrameCodec, Pointers, length_octets
from telepresence.link.profile import DOWNLINK, UPLINK
from telepresence.link.reassembly import PacketReassembly
from telepresence.link.receiver import LinkReceiver
from telepresence.link.sender import LinkSender

MS = 1_000_000
RAW = [packet_flow(f"raw{level}", level) for level in Level]


def with_fecf(body):
    return body + crc_hqx(body, 0xFFFF).to_bytes(2, "big")


def primary(profile, count, *, sample, vcid=None):
    """Version 1, SCID, VCID; 24 bits of count; signaling, of which the sample's flag is one."""
    first = 0x4000 | profile.scid << 6 | (profile.vcid if vcid is None else vcid)
    return (
        first.to_bytes(2, "big") + (count % (1 << 24)).to_bytes(3, "big") + bytes([0x40 * sample])
    )


@settings(max_examples=40)
@given(st.integers(0, 1 << 25), st.none() | st.binary(min_size=12, max_size=12), st.data())
def test_a_frame_is_read_as_it_was_written(count, sample, data):
    for profile, most, mpdu in ((UPLINK, 31, False), (DOWNLINK, 2047, True)):
        size = profile.largest_zone_octets - (12 if sample else 0)
        pointer = data.draw(st.integers(0, most))
        zone = data.draw(st.binary(min_size=1, max_size=8)).ljust(size, b"z")
        codec = FrameCodec(profile)
        frame = codec.pack(count, sample, pointer, zone)
        head = primary(
            profile,
            count,
            sample=sample is not None,
            vcid=None if mpdu else profile.vcid + pointer,
        )
        code = pointer.to_bytes(2, "big") if mpdu else b""
        assert frame == with_fecf(head + (sample or b"") + code + zone)
        assert codec.parse(frame) == (count % (1 << 24), sample, pointer, zone)
        idle = codec.pack_idle(count, sample)
        assert idle == codec.pack(count, sample, Pointers(profile).idle, bytes(size))
        assert codec.parse(idle)[2:] == (Pointers(profile).idle, bytes(size))


@pytest.mark.parametrize("profile", [UPLINK, DOWNLINK])
@pytest.mark.parametrize("sample", [None, bytes(range(12))])
def test_a_frame_of_another_channel_or_kind_is_told_by_its_field(profile, sample):
    codec = FrameCodec(profile)
    for frame in (codec.pack_idle(7, sample), codec.pack(7, sample, 0, bytes(500))):
        body = bytearray(frame[:-2])

        def parsed(body=body, **changes):
            changed = bytearray(body)
            for at, mask in changes.items():
                changed[int(at[1:])] ^= mask
            return codec.parse(with_fecf(bytes(changed)))

        assert not isinstance(parsed(), str)
        assert parsed(_0=0x80) == parsed(_0=0x40) == "version"
        assert parsed(_0=0x20) == parsed(_1=0x40) == "scid"
        assert parsed(_1=0x20) == "vcid"
        for bit in (0x80, 0x20, 0x10, 0x08, 0x01):
            assert parsed(_5=bit) == "signaling"
        for at in (0, 6, len(frame) // 2, len(frame) - 1):
            assert codec.parse(frame[:at] + bytes([frame[at] ^ 4]) + frame[at + 1 :]) == "fecf"
        assert codec.parse(frame[:-1]) == codec.parse(frame + b"\0") == "length"
        if profile is DOWNLINK:
            # An M_PDU header has five spare bits.
            at = f"_{6 + len(sample or b'')}"
            assert parsed(**{at: 0x08}) == "mpdu"


def test_the_codes_of_a_pointer_are_its_largest_values():
    for profile, ones in ((UPLINK, 31), (DOWNLINK, 2047)):
        codes = Pointers(profile)
        assert (codes.no_start, codes.idle, codes.preempt, codes.supervision) == (
            *(ones, ones - 1, ones - 2, ones - 3),
        )
    # A closed piece of up to 127 octets has a length of one octet, beside its tag.
    edge = replace(DOWNLINK, frame_octets=6 + 2 + 129 + 2)
    assert edge.largest_zone_octets == 129
    longer = replace(edge, frame_octets=edge.frame_octets + 1)
    assert [length_octets(one) for one in (UPLINK, edge, longer, DOWNLINK)] == [1, 1, 2, 2]


def zones(*items, flows=RAW, deliver=True):
    """What comes of zones of 20 octets: packets, and the counts of those dropped."""
    events = deque()
    profile = replace(DOWNLINK, frame_octets=30, insert_octets=0)
    packets = PacketReassembly(profile, flows, events)
    packets.deliver = deliver
    codes = Pointers(profile)
    for count, (pointer, zone) in enumerate(items):
        code = getattr(codes, pointer) if isinstance(pointer, str) else pointer
        packets.handle_zone(code, zone.ljust(20, b"\0"), count, count * MS)
    return [(event.flow.name, event.data) for event in events if hasattr(event, "flow")], packets


def raw(level, closed=True):
    return 0x80 * closed | 1 << 3 | level


def test_packets_lie_in_zones_as_the_format_says():
    found, packets = zones(
        # Two closed ones, one with a long length and a pad before it; then fill.
        (0, bytes([raw(0), 2]) + b"ab" + bytes([1, raw(1), 0x80, 3]) + b"cde"),
        # One that goes on through two zones; its end is at 3.
        (0, bytes([raw(2, False)]) + b"x" * 19),
        ("no_start", b"y" * 20),
        (3, b"zzz" + bytes([raw(3), 1]) + b"f"),
        # One that fills its zone ends with it: the next pointer says so.
        (0, bytes([raw(1, False)]) + b"w" * 19),
        ("idle", b""),
        # It waits for one of a higher level, and is resumed; its end is closed.
        (0, bytes([raw(3, False)]) + b"v" * 19),
        ("preempt", bytes([raw(0), 1]) + b"g" + bytes([0x87, 2]) + b"vv"),
        # And one whose last octet is the zone's.
        (0, bytes([raw(0, False)]) + b"u" * 19),
        (20, b"t" * 20),
    )
    assert found == [
        ("raw0", b"ab"),
        ("raw1", b"cde"),
        ("raw2", b"x" * 19 + b"y" * 20 + b"zzz"),
        ("raw3", b"f"),
        ("raw1", b"w" * 19),
        ("raw0", b"g"),
        ("raw3", b"v" * 19 + b"vv"),
        ("raw0", b"u" * 19 + b"t" * 20),
    ]
    assert packets.received == [3, 2, 1, 2] and packets.dropped == {}


@pytest.mark.parametrize(
    "zone",
    [
        bytes([0x02]),  # an undefined control code
        bytes([0x03]),
        bytes([raw(5), 1]),  # a flow that there is not
        bytes([raw(0), 19]),  # longer than the zone
        bytes([raw(0), 0x80, 18]),
        bytes([1]) * 19 + bytes([raw(0)]),  # without its length
        bytes([1]) * 18 + bytes([raw(0), 0x80]),
    ],
)
def test_a_zone_against_the_format_drops_all_that_is_in_progress(zone):
    begun = (0, bytes([raw(2, False)]) + b"x" * 19)
    found, packets = zones(begun, ("preempt", zone), ("no_start", b"y" * 20), ("idle", b""))
    assert found == [] and packets.dropped == {"malformed": 1, "incomplete": 1}
    # A pointer beyond the zone is as bad; what comes after it is read again.
    found, packets = zones(begun, (21, b""), (0, bytes([raw(0), 1]) + b"a"))
    assert found == [("raw0", b"a")] and packets.dropped == {"malformed": 1, "incomplete": 1}


def test_a_packet_that_is_followed_by_another_of_its_level_was_dropped():
    begun = (0, bytes([raw(2, False)]) + b"x" * 19)
    found, packets = zones(begun, ("preempt", bytes([raw(2), 1]) + b"a"), ("idle", b""))
    assert found == [("raw2", b"a")] and packets.dropped == {"incomplete": 1}
    # Without approval all is counted, and none delivered; a kind that no raw flow has is garbage.
    found, packets = zones(
        (0, bytes([raw(2), 1]) + b"a" + bytes([0x80 | 4 << 3 | 1, 1]) + b"b"), deliver=False
    )
    assert found == [] and packets.dropped == {"unapproved": 1, "malformed": 1}
    # A packet beyond all measure ends; 2048 octets fit.
    endless = [begun, *[("no_start", b"y" * 20)] * 110, ("idle", b"")]
    found, packets = zones(*endless)
    assert found == [] and packets.dropped == {"oversize": 1}


@pytest.mark.parametrize(
    ("flow", "data", "plausible"),
    [
        (video_flow("f"), b"\x80" + bytes(11), True),
        (video_flow("f"), b"\x80" + bytes(10), False),
        (video_flow("f"), b"\x40" + bytes(11), False),
        (video_flow("f"), b"\xc0" + bytes(11), False),
        (rtcp_flow("f"), b"\x80\xc0" + bytes(6), True),
        (rtcp_flow("f"), b"\x80\xdf" + bytes(6), True),
        (rtcp_flow("f"), b"\x80\xbf" + bytes(6), False),
        (rtcp_flow("f"), b"\x80\xe0" + bytes(6), False),
        (rtcp_flow("f"), b"\x80\xc8" + bytes(5), False),
        (rtcp_flow("f"), b"\x40\xc8" + bytes(6), False),
        (tmtc_flow("f"), bytes(12), False),
        (packet_flow("f", Level.VIDEO), b"", True),
        (packet_flow("f", Level.VIDEO), bytes(2048), True),
    ],
)
def test_garbage_takes_no_capacity(flow, data, plausible):
    sender = LinkSender(DOWNLINK, [flow])
    assert sender.handle_packet("f", data, 0) is plausible
    assert sender.refused["garbage"] == (not plausible)
    assert not sender.handle_packet("f", bytes(2049), 0) and sender.refused["oversize"] == 1
    assert not sender.handle_haptic(bytes(11), 0) and sender.refused["haptic_length"] == 1


@pytest.mark.parametrize("profile", [UPLINK, DOWNLINK])
@settings(max_examples=12)
@given(data=st.data())
def test_every_octet_of_every_frame_is_accounted_for_and_every_packet_comes(profile, data):
    sender, receiver = LinkSender(profile, RAW, first_count=5), LinkReceiver(profile, RAW)
    sizes = data.draw(st.lists(st.tuples(st.integers(0, 3), st.integers(1, 700)), max_size=12))
    sent, got, now_ns = [], [], 0
    for number, (level, size) in enumerate(sizes):
        packet = bytes([number]) * size
        assert sender.handle_packet(f"raw{level}", packet, now_ns)
        sent.append((f"raw{level}", packet))
    samples = messages = 0
    for slot in range(600):
        if slot % 3 == 0:
            samples += sender.handle_haptic(bytes(12), now_ns)
        supervision = bytes(range(12)) if slot % 7 == 0 else None
        messages += supervision is not None
        frame = sender.poll_transmit(now_ns, supervision)
        assert len(frame) == profile.frame_octets and receiver.handle_frame(frame, now_ns)
        while (event := receiver.next_event()) is not None:
            if hasattr(event, "flow"):
                got.append((event.flow.name, event.data))
        now_ns += profile.slot_ns
    octets = sender.octets()
    assert sum(octets.values()) == 600 * profile.frame_octets and sender.frames_sent == 600
    assert octets["haptic"] == 12 * samples and octets["supervision"] == 12 * messages
    carried = sum(octets[level.name.lower()] for level in Level)
    left = sum(sender.waiting_octets(level) for level in Level) + sender.begun_octets(Level(3))
    if profile is DOWNLINK:
        assert sorted(got) == sorted(sent) and left == 0
        assert carried == sum(size for _, size in sizes)
    assert set(got) <= set(sent) and len(set(got)) == len(got)
    # Within a level the order stays; on a narrow link some grow too old.
    for level in range(4):
        order = iter([packet for name, packet in sent if name == f"raw{level}"])
        assert all(packet in order for name, packet in got if name == f"raw{level}")
    report = receiver.report()
    assert (report.frames_received, report.frames_lost, report.restarts) == (600, 0, 0)
    assert (report.haptic_received, report.supervision_received) == (samples, messages)
