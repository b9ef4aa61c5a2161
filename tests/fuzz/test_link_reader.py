"""Invariants of a sender, checked by a reader written from docs/wire-formats.md alone.

In each frame the levels of the pieces only fall. A piece of a lower level follows only after all
packets of higher levels that waited when the frame began. There is no fill while anything waits.
Each channel's packets come in order, once and whole, for any supervision slots and missing samples.
The sender's counts equal the reader's, octet by octet.
"""

from collections import Counter

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from telepresence.link.flows import Level, packet_flow
from telepresence.link.profile import DOWNLINK, UPLINK, LinkProfile
from telepresence.link.queues import DropPolicy, QueueLimits
from telepresence.link.sender import LinkSender

MS = 1_000_000
FLOWS = [
    packet_flow("tmtc", Level.TMTC),
    packet_flow("voice", Level.VOICE),
    packet_flow("video", Level.VIDEO),
    packet_flow("more video", Level.VIDEO),
    packet_flow("maintenance", Level.MAINTENANCE),
]
LEVELS = [flow.level for flow in FLOWS]
KINDS = [level.name.lower() for level in Level]
PATIENT = QueueLimits(
    depth_octets=100_000, max_age_ns=3_600_000 * MS, policy=DropPolicy.REJECT_NEWEST
)
#: Its zone of 190 octets is the smallest in which both sizes of length fields occur.
MIDDLE = LinkProfile(name="middle", frame_octets=212, scid=1)


class Reader:
    """Implements the tables of docs/link*.md: no loss, no restart, raw packets only."""

    def __init__(self, profile):
        self.short = profile.pointer_in_vcid
        self.insert_octets = profile.insert_octets
        self.in_flight = None  # flow number and what has come of it
        self.paused = {}  # by level
        self.packets = []  # (flow number, data), as they end
        self.pieces = []  # of the last frame: (level, begins, ends)
        self.filled = 0  # octets of fill in the last frame
        self.ended_before = None  # level of the packet that, it said, the frame before had ended
        self.books = Counter()

    def frame(self, frame):
        self.pieces, self.filled, self.ended_before = [], 0, None
        self.books.update(header=6, fecf=2)
        at, sample = 6, bool(frame[5] & 0x40)
        if sample:
            at += self.insert_octets
            self.books["haptic"] += self.insert_octets
        if self.short:
            pointer, ones = frame[1] & 0x3F, 0x1F
        else:
            pointer, ones = int.from_bytes(frame[at : at + 2], "big"), 0x7FF
            at += 2
            self.books["framing"] += 2
        zone = frame[at:-2]
        if pointer == ones - 3:
            self.books.update(supervision=12, idle=len(zone) - 12)
            assert not any(zone[12:])
            return zone[:12]
        if pointer == ones:
            self.go_on(zone)
        elif pointer == ones - 1:
            self.end()
            self.fill(zone)
        elif pointer == ones - 2:
            if self.in_flight:
                self.paused[LEVELS[self.in_flight[0]]] = self.in_flight
            self.in_flight = None
            self.tags(zone)
        else:
            if self.in_flight and pointer:
                self.go_on(zone[:pointer])
            self.end()
            self.tags(zone[pointer:])
        return None

    def tags(self, zone):
        while zone:
            tag, zone = zone[0], zone[1:]
            closed, kind, number = tag >> 7, tag >> 3 & 0xF, tag & 7
            if tag == 0x01:
                self.books["framing"] += 1
                continue
            if tag == 0x00:
                self.fill(b"\0" + zone)
                return
            assert kind == 1 or (kind == 0 and number >= 4)
            self.books["packet_headers" if kind else "framing"] += 1
            length = len(zone)
            if closed:
                octets = 2 if zone[0] & 0x80 else 1
                length = int.from_bytes(zone[:octets], "big") & 0x7FFF
                zone = zone[octets:]
                self.books["framing"] += octets
                assert length <= len(zone)
            if kind:
                assert LEVELS[number] not in self.paused
                self.in_flight = (number, b"")
            else:
                self.in_flight = self.paused.pop(number - 4)
            self.go_on(zone[:length], begins=bool(kind))
            zone = zone[length:]
            if closed:
                self.end()

    def go_on(self, octets, begins=False):
        number, data = self.in_flight
        self.in_flight = (number, data + octets)
        self.books[KINDS[LEVELS[number]]] += len(octets)
        self.pieces.append([LEVELS[number], begins, False])

    def end(self):
        if self.in_flight:
            self.packets.append(self.in_flight)
            if self.pieces:
                self.pieces[-1][2] = True
            else:
                self.ended_before = LEVELS[self.in_flight[0]]
        self.in_flight = None

    def fill(self, zone):
        assert not any(zone)
        self.filled = len(zone)
        self.books["idle"] += len(zone)


slots = st.lists(
    st.tuples(
        st.lists(  # packets that are put in before this slot: flow and octets
            st.tuples(
                st.integers(0, len(FLOWS) - 1),
                st.integers(0, 40) | st.sampled_from([0, 9, 10, 11, 22, 127, 128, 187, 475, 2048]),
            ),
            max_size=3,
        ),
        st.booleans() | st.just(True),  # a sample
        st.sampled_from([False, False, False, True]),  # a supervision slot
        st.sampled_from([0, 0, 0, 1, 5]),  # slots in which nothing more happens
    ),
    min_size=1,
    max_size=40,
)


@pytest.mark.parametrize("profile", [UPLINK, MIDDLE, DOWNLINK], ids=lambda profile: profile.name)
@given(slots=slots)
@settings(max_examples=200, deadline=None)
def test_priorities_fill_order_and_ledger(profile, slots):
    sender = LinkSender(profile, FLOWS, limits=dict.fromkeys(Level, PATIENT))
    reader = Reader(profile)
    put, unfinished = [], [0] * len(Level)  # packets of each level that have not ended
    frames = 0

    def slot(sample, message):
        nonlocal frames
        waited, ended = list(unfinished), len(reader.packets)
        if sample:
            sender.handle_haptic(bytes(profile.insert_octets), frames * MS)
        frame = sender.poll_transmit(frames * MS, message)
        frames += 1
        assert reader.frame(frame) == message
        # Only the next frame shows that a packet which fills its zone has ended.
        for number, _ in reader.packets[ended:]:
            unfinished[LEVELS[number]] -= 1
        if message:
            return
        levels = [level for level, _, _ in reader.pieces]
        assert levels == sorted(levels)
        for level, _, _ in reader.pieces:
            for higher in range(level):
                ends = sum(end for piece, _, end in reader.pieces if piece == higher)
                assert waited[higher] <= ends + (reader.ended_before == higher)
        if reader.filled:
            assert not any(unfinished)
        assert sender.octets() == {key: reader.books[key] for key in sender.octets()}
        assert sum(reader.books.values()) == frames * profile.frame_octets

    for packets, sample, supervision, quiet in slots:
        for number, octets in packets:
            data = bytes([len(put) % 251]) * octets
            assert sender.handle_packet(FLOWS[number].name, data, frames * MS)
            put.append((number, data))
            unfinished[LEVELS[number]] += 1
        slot(sample, b"twelve octet" if supervision else None)
        for _ in range(quiet):
            slot(sample, None)
    for _ in range(20_000):
        if not any(unfinished):
            break
        slot(True, None)
    # Within a level packets come in order; across levels any order is possible.
    for level in Level:
        assert [p for p in reader.packets if LEVELS[p[0]] == level] == [
            p for p in put if LEVELS[p[0]] == level
        ]
