"""Invariants for any disturbance by the radio.

Each packet that comes out was put in, is whole, and comes once and in the order of its flow.
Samples come in order. What is sent after the last disturbance comes out. Each lost packet is
counted where it was dropped, and the octet counts are exact.

The radio loses, repeats and reorders frames. It flips up to three bits, or a burst of up to 16,
which the FECF always detects (docs/link-format.md has what it may miss).
"""

import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from telepresence.link.flows import (
    HapticReceived,
    Level,
    PacketReceived,
    SupervisionReceived,
    packet_flow,
    video_flow,
    voice_flow,
)
from telepresence.link.profile import DOWNLINK, UPLINK, LinkProfile
from telepresence.link.receiver import LinkReceiver
from telepresence.link.sender import LinkSender

MS = 1_000_000
FLOWS = [
    video_flow("video"),
    voice_flow("voice"),
    packet_flow("tmtc", Level.TMTC),
    packet_flow("more_tmtc", Level.TMTC),
    packet_flow("maintenance", Level.MAINTENANCE),
]
RTP_FLOWS = ("video", "voice")
#: A zone of few octets with an M_PDU header: all packets are in pieces, all lengths corner cases.
NARROW = LinkProfile(name="narrow", frame_octets=34, scid=1)

arrivals = st.lists(
    st.tuples(
        st.sampled_from([0, 0, 0, 1, 1, 2, 3, 7, 20, 33]),  # slots since the one before
        st.sampled_from([flow.name for flow in FLOWS]),
        st.integers(0, 60) | st.sampled_from([400, 2000]),  # octets of payload
        st.sampled_from([0, 0, 0, 0, 1]),  # an RTP stream that begins anew
        st.sampled_from([None] * 12 + ["flush", "patience", "patient", "unheard", "heard"]),
    ),
    min_size=1,
    max_size=50,
)
disturbances = st.lists(
    st.tuples(
        st.integers(0, 60),  # good frames before it
        st.sampled_from(["lose", "lose", "lose", "repeat", "swap", "flip", "burst"]),
        st.sampled_from([1, 1, 2, 5, 30]),
        st.randoms(use_true_random=False),
    ),
    max_size=12,
)
#: Which slots have a sample, and which have a supervision message: every n-th, 0 for none.
every = st.sampled_from([0, 1, 1, 2, 3, 7])


class Traffic:
    """Return packets that differ from each other wherever their length allows it."""

    def __init__(self):
        self.number = 0
        self.life = 0

    def packet(self, name, octets, new_life, slot):
        self.number += 1
        self.life += new_life
        payload = (struct.pack(">I", self.number) * (octets // 4 + 1))[:octets]
        if name not in RTP_FLOWS:
            return payload
        stamp = slot * 90 if name == "video" else self.number * 960
        header = (0x80, self.number << 7 & 0x80 | 96, self.number & 0xFFFF, stamp, self.life)
        return struct.pack(">BBHII", *header) + payload


class Radio:
    """Takes frames and returns disturbed frames."""

    def __init__(self, disturbances):
        self.ways = {}
        slot = 0
        for good, way, octets, random in disturbances:
            for k in range(octets):
                self.ways[slot + good + k] = way, random
            slot += good + octets
        self.last = max(self.ways, default=-1)
        self.late = None

    def pass_on(self, slot, frame):
        way, random = self.ways.get(slot, (None, None))
        held, self.late = self.late, None
        out = [frame]
        if way == "lose":
            out = []
        elif way == "repeat":
            out = [frame, frame]
        elif way == "swap" and held is None:
            self.late = frame
            return []
        elif way in ("flip", "burst"):
            bits = int.from_bytes(frame, "big")
            width = 8 * len(frame)
            if way == "flip":
                flips = random.sample(range(width), random.randint(1, 3))
            else:
                first = random.randrange(width - 15)
                flips = [first, *(k for k in range(first + 1, first + 16) if random.random() < 0.5)]
            for bit in flips:
                bits ^= 1 << bit
            out = [bits.to_bytes(len(frame), "big")]
        return out if held is None else [*out, held]


@pytest.mark.parametrize("profile", [UPLINK, NARROW, DOWNLINK], ids=lambda profile: profile.name)
@given(
    arrivals=arrivals,
    disturbances=disturbances,
    sampled=every,
    supervised=st.sampled_from([0, 0, 20, 2]),
)
@settings(max_examples=150, deadline=None)
def test_what_comes_out_was_put_in(profile, arrivals, disturbances, sampled, supervised):
    sender, receiver = LinkSender(profile, FLOWS), LinkReceiver(profile, FLOWS)
    radio = Radio(disturbances)
    traffic, put, got, samples, messages = Traffic(), {}, {}, [], []
    slot = 0

    def run_slot():
        if sampled and slot % sampled == 0:
            sender.handle_haptic(struct.pack(">QI", slot, 0), slot * MS)
        message = None
        if supervised and slot % supervised == 1:
            message = struct.pack(">QI", slot, 1)
        frame = sender.poll_transmit(slot * MS, message)
        for arrived in radio.pass_on(slot, frame):
            receiver.handle_frame(arrived, slot * MS)
        while event := receiver.next_event():
            if isinstance(event, HapticReceived):
                samples.append(struct.unpack_from(">Q", event.sample)[0])
            elif isinstance(event, SupervisionReceived):
                messages.append(struct.unpack(">QI", event.message))
            else:
                assert isinstance(event, PacketReceived)
                got.setdefault(event.flow.name, []).append(event.data)

    for wait, name, octets, new_life, command in arrivals:
        for _ in range(wait):
            run_slot()
            slot += 1
        if command == "flush":
            sender.flush(slot * MS)
            assert not any(sender.waiting_octets(level) for level in Level)
        elif command in ("patience", "patient"):
            sender.set_patience(50 * MS if command == "patience" else None)
        elif command:
            sender.handle_peer(heard=command == "heard")
        data = traffic.packet(name, octets, new_life, slot)
        if sender.handle_packet(name, data, slot * MS):
            put.setdefault(name, []).append((data, slot))
    idle_slots = 0
    while idle_slots < 3 or slot <= radio.last + 2:
        carried = sender.octets()
        run_slot()
        slot += 1
        now = sender.octets()
        same = all(carried[level.name.lower()] == now[level.name.lower()] for level in Level)
        idle_slots = idle_slots + (carried["supervision"] == now["supervision"]) if same else 0

    carrying = range(0, slot, sampled) if sampled else range(0)
    ends = {level: sender.report(slot * MS).queue[level.name.lower()] for level in Level}
    assert sum(sender.octets().values()) == slot * profile.frame_octets
    # In order and once for any disturbance; complete without one.
    assert samples == sorted(set(samples) & set(carrying))
    assert messages == sorted({(number, 1) for number, _ in messages})
    if not radio.ways:
        assert samples == list(carrying)
    for name in got:
        rest = iter(put[name])
        for data in got[name]:
            assert any(data == candidate for candidate, _ in rest), (name, data)
    for name, packets in put.items():
        level = next(flow.level for flow in FLOWS if flow.name == name)
        if ends[level].drops["expired"] or ends[level].drops["signal_lost"]:
            continue
        out = got.get(name, [])
        if not radio.ways:
            assert out == [data for data, _ in packets]
        elif name not in RTP_FLOWS:
            after = [data for data, since in packets if since > radio.last + 1]
            assert out[len(out) - len(after) :] == after
    # Each accepted packet was dropped by its queue, or sent; then it was received or dropped there.
    accepted = sum(queue.accepted for queue in ends.values())
    dropped = sum(sum(queue.drops.values()) for queue in ends.values())
    refused = sum(queue.drops["full"] for queue in ends.values())
    if not radio.ways and not refused:
        received = sum(receiver.packets.received)
        in_part = receiver.packets.dropped.get("incomplete", 0)
        no_context = receiver.packets.dropped.get("no_context", 0)
        assert accepted - dropped == received + no_context
        assert in_part <= dropped


def test_a_gap_of_ten_seconds_leaves_no_trace():
    """Live streams at the uplink's caps; the first whole packet after the gap is exact."""
    sender, receiver = LinkSender(UPLINK, FLOWS), LinkReceiver(UPLINK, FLOWS)
    put, got = [], []
    for slot in range(26_000):
        if slot % 33 == 0:
            header = (
                0x80,
                0xE0,
                slot // 33 + 65_500 & 0xFFFF,
                slot * 90 + 2**32 - 9 & 2**32 - 1,
                5,
            )
            put.append(struct.pack(">BBHII", *header) + struct.pack(">I", slot) * 80)
            sender.handle_packet("video", put[-1], slot * MS)
        if slot % 20 == 3:
            header = (0x80, 97, slot // 20 + 65_000 & 0xFFFF, slot // 20 * 960, 6)
            put.append(struct.pack(">BBHII", *header) + struct.pack(">I", slot) * 5)
            sender.handle_packet("voice", put[-1], slot * MS)
        frame = sender.poll_transmit(slot * MS)
        if not 9_990 <= slot < 19_990:
            receiver.handle_frame(frame, slot * MS)
        while event := receiver.next_event():
            got.append((slot, event.data))
    assert receiver.packets.dropped.keys() <= {"incomplete"}
    known = set(put)
    assert all(data in known for _, data in got)
    assert min(slot for slot, _ in got if slot >= 19_990) < 19_990 + 25
    assert receiver.frames_lost == 10_000
