"""The invariant: whatever gets lost on the radio, each packet that comes out was put in, whole, in
the order of its flow and once. And what is sent after the last loss comes out."""

import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from telepresence.link.flows import Level, packet_flow, video_flow, voice_flow
from telepresence.link.profile import DOWNLINK, UPLINK, LinkProfile
from telepresence.link.receiver import HapticReceived, LinkReceiver
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
#: A zone of few octets with an M_PDU header: each packet is in pieces, each length a corner case.
NARROW = LinkProfile(name="narrow", frame_octets=29, scid=1)

arrivals = st.lists(
    st.tuples(
        st.sampled_from([0, 0, 0, 1, 1, 2, 3, 7, 20, 33]),  # slots since the one before
        st.sampled_from([flow.name for flow in FLOWS]),
        st.integers(0, 60) | st.sampled_from([400, 2000]),  # octets of payload
        st.sampled_from([0, 0, 0, 0, 1]),  # an RTP stream that begins anew
    ),
    min_size=1,
    max_size=50,
)
losses = st.lists(st.tuples(st.integers(0, 60), st.sampled_from([1, 1, 2, 5, 30])), max_size=12)


class Traffic:
    """Packets that differ from each other wherever their length allows it."""

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


@pytest.mark.parametrize("profile", [UPLINK, NARROW, DOWNLINK], ids=lambda profile: profile.name)
@given(arrivals=arrivals, losses=losses)
@settings(max_examples=250, deadline=None)
def test_what_comes_out_was_put_in(profile, arrivals, losses):
    sender, receiver = LinkSender(profile, FLOWS), LinkReceiver(profile, FLOWS)
    lost, slot = set(), 0
    for good, bad in losses:
        lost.update(range(slot + good, slot + good + bad))
        slot += good + bad
    last_lost = max(lost, default=-1)
    traffic, put, got, samples = Traffic(), {}, {}, []
    slot = 0

    def run_slot():
        sender.handle_haptic(struct.pack(">QI", slot, 0), slot * MS)
        frame = sender.poll_transmit(slot * MS)
        if slot not in lost:
            receiver.handle_frame(frame, slot * MS)
        while event := receiver.next_event():
            if isinstance(event, HapticReceived):
                samples.append(struct.unpack_from(">Q", event.sample)[0])
            else:
                got.setdefault(event.flow.name, []).append(event.data)

    for wait, name, octets, new_life in arrivals:
        for _ in range(wait):
            run_slot()
            slot += 1
        data = traffic.packet(name, octets, new_life, slot)
        if sender.handle_packet(name, data, slot * MS):
            put.setdefault(name, []).append((data, slot))
    idle_slots = 0
    while idle_slots < 2 or slot <= last_lost + 1:
        carried = sender.octets()
        run_slot()
        slot += 1
        idle = sender.octets()["idle"] - carried["idle"]
        idle_slots = idle_slots + 1 if idle == profile.packet_zone_octets else 0

    assert samples == [k for k in range(slot) if k not in lost]
    assert sum(sender.octets().values()) == slot * profile.frame_octets
    expired = any(queue["drops"]["expired"] for queue in sender.report(slot * MS)["queue"].values())
    for name in got:
        rest = iter(put[name])
        for data in got[name]:
            assert any(data == candidate for candidate, _ in rest), (name, data)
    for name, packets in put.items():
        if expired:
            continue
        out = got.get(name, [])
        if not lost:
            assert out == [data for data, _ in packets]
        elif name not in RTP_FLOWS:
            after = [data for data, since in packets if since > last_lost]
            assert out[len(out) - len(after) :] == after


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
    assert receiver.packets_dropped.keys() <= {"incomplete"}
    known = set(put)
    assert all(data in known for _, data in got)
    assert min(slot for slot, _ in got if slot >= 19_990) < 19_990 + 25
    assert receiver.frames_lost == 10_000
