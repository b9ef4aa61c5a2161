"""For any source and any loss, no header is restored wrongly (hypothesis)."""

from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from link_header_sources import Path, rtp

from telepresence.link.flows import video_flow, voice_flow

VIDEO, VOICE = video_flow("video"), voice_flow("voice")
FLOWS = pytest.mark.parametrize("flow", [VIDEO, VOICE], ids=["video", "voice"])

#: One behaviour of a source: its number of packets, and for each packet: slots since the last one,
#: step of the sequence number, distance of the timestamp from the link's time, marker.
habits = st.fixed_dictionaries(
    {
        "packets": st.integers(1, 60),
        "slots": st.sampled_from([0, 1, 11, 20, 33, 33, 40, 66, 500, 3000]),
        "more_slots": st.integers(0, 30),
        "sequence": st.sampled_from([1, 1, 1, 1, 2, 5, 20, 300, -1, 0, 40_000]),
        "off_ticks": st.sampled_from([0, 0, 1, 60, 180, 1500, 6000]),
        "grid": st.sampled_from([1, 960, 3000, 3000, 3600, 3753, 1500]),
        "ppm": st.sampled_from([0, 0, 200, -200]),
        "marker_each": st.sampled_from([1, 1, 2, 3, 1000]),
        "jump_ticks": st.sampled_from([0, 0, 0, 0, 960, 90_000, 1 << 31, -5]),
        "new_source": st.sampled_from([False, False, False, True]),
        "payload_type": st.sampled_from([96, 96, 96, 97]),
        "gap_slots": st.sampled_from([0, 0, 0, 100, 10_000, 12_200, 13_000, 600_000, 901_000]),
        "loss": st.sampled_from([0.0, 0.0, 0.1, 0.7, 1.0]),
        "acknowledgement_loss": st.sampled_from([0.0, 0.3, 1.0]),
        "delay_slots": st.integers(1, 800),
        "event": st.sampled_from(["", "", "", "deaf", "heard", "receiver", "sender"]),
    }
)


class Source:
    """Packets by habits, with numbers and timestamps near their wraps."""

    def __init__(self, seed):
        self.random = Random(seed)
        self.count = self.random.randrange(1 << 25)
        self.drift = 0.0
        self.begin()

    def begin(self):
        random = self.random
        self.sequence = random.choice([0, 65_500, random.randrange(1 << 16)])
        self.offset = random.choice([0, (1 << 32) - 50_000, random.randrange(1 << 32)])
        self.ssrc = random.randrange(1 << 32)
        self.packets = 0

    def packet(self, habit, ticks_a_slot):
        slots = habit["slots"] + self.random.randrange(habit["more_slots"] + 1)
        self.count += slots
        self.drift += slots * ticks_a_slot * habit["ppm"] * 1e-6
        self.packets += 1
        self.sequence += habit["sequence"]
        line = self.count * ticks_a_slot + round(self.drift)
        line -= line % habit["grid"]
        line += self.random.randint(-habit["off_ticks"], habit["off_ticks"])
        return self.count, rtp(
            self.sequence,
            self.offset + line,
            marker=int(self.packets % habit["marker_each"] == 0),
            payload_type=habit["payload_type"],
            ssrc=self.ssrc,
        )


def run(flow, path, source, habit):
    source.offset += habit["jump_ticks"]
    if habit["new_source"]:
        source.begin()
    for k in range(habit["packets"]):
        count, packet = source.packet(habit, 48 if flow is VOICE else 90)
        path.send(
            count,
            packet,
            arrives=source.random.random() >= habit["loss"],
            told=source.random.random() >= habit["acknowledgement_loss"],
            delay_slots=habit["delay_slots"],
        )
        if k == habit["packets"] // 2:
            source.count += habit["gap_slots"]


@FLOWS
@given(seed=st.integers(0, 1 << 30), history=st.lists(habits, max_size=12), heard=st.booleans())
@settings(max_examples=150)
def test_exact_or_not_at_all(flow, seed, history, heard):
    """Restarts of either end, deafness, any losses: `Path.send` checks all that comes out."""
    source, path = Source(seed), Path(flow, heard=heard)
    for habit in history:
        if habit["event"] == "receiver":
            path.receiver_restarts(source.count, habit["delay_slots"])
        elif habit["event"] == "sender":
            # The receiver notices; acknowledgements to the old life never reach the new one.
            path = Path(flow, heard=path.heard)
        elif habit["event"]:
            path.hear(habit["event"] == "heard")
        run(flow, path, source, habit)


@FLOWS
@given(seed=st.integers(0, 1 << 30), history=st.lists(habits, max_size=12))
@settings(max_examples=150)
def test_two_way_every_received_packet_is_decompressed(flow, seed, history):
    """While the peer is heard and does not restart, no loss makes a later packet unreadable."""
    source, path = Source(seed), Path(flow)
    for habit in history:
        run(flow, path, source, habit)
    assert all(exact for _, _, exact in path.outcomes)
