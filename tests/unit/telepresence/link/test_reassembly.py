"""Packets from zones, octet by octet, as docs/wire-formats.md says."""

from collections import deque
from dataclasses import replace

import pytest

from telepresence.link.flows import Level, packet_flow
from telepresence.link.frame import Pointers
from telepresence.link.profile import DOWNLINK
from telepresence.link.reassembly import PacketReassembly

MS = 1_000_000
RAW = [packet_flow(f"raw{level}", level) for level in Level]


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
