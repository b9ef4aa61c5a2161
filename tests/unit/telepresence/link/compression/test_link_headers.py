"""Header compression between two complete gateways on virtual time: losses and restarts."""

import struct
from random import Random

import pytest
from virtual_link import VirtualLink

from telepresence.link.flows import video_flow, voice_flow
from telepresence.link.gateway import Gateway
from telepresence.link.profile import DOWNLINK, UPLINK
from telepresence.link.radio import RadioPath

MS = 1_000_000
UP = [voice_flow("voice"), video_flow("video")]
DOWN = [voice_flow("voice"), video_flow("video")]


class Path(RadioPath):
    """A radio path that loses some or all frames."""

    loss = 0.0
    random = Random(0)

    def handle_frame(self, frame, now_ns):
        if self.random.random() >= self.loss:
            super().handle_frame(frame, now_ns)


class Session:
    """Voice and video both ways; what comes out must have gone in, in its order."""

    def __init__(self, delay_ms, seed):
        self.up, self.down = Path(delay_ns=delay_ms * MS), Path(delay_ns=delay_ms * MS)
        self.up.random = self.down.random = self.random = Random(seed)
        self.delay_ms = delay_ms
        self.link = VirtualLink(
            uplink_flows=UP, downlink_flows=DOWN, up=self.up, down=self.down, seed=seed
        )
        self.slot = 0
        self.sent = {}
        self.last = {}
        self.received = 0
        self.sources = {}
        for side in ("ground", "space"):
            self.new_source(side)

    def new_source(self, side):
        random = self.random
        self.sources[side] = {
            flow: [random.randrange(1 << 16), random.randrange(1 << 32), random.randrange(1 << 32)]
            for flow in ("voice", "video")
        }

    def new_life(self, side):
        """Restart the gateway and its sources."""
        old = getattr(self.link, side)
        ground = side == "ground"
        new = Gateway(
            transmit=UPLINK if ground else DOWNLINK,
            transmit_flows=UP if ground else DOWN,
            receive=DOWNLINK if ground else UPLINK,
            receive_flows=DOWN if ground else UP,
            radio=old.radio,
            master=ground,
            life=self.random.randrange(1, 0xFFFF),
            now_ns=self.link.now_ns,
        )
        setattr(self.link, side, new)
        self.new_source(side)

    def run(self, slots):
        for _ in range(slots):
            for side in ("ground", "space"):
                if self.slot % 20 == 0:
                    self.put(side, "voice", 960, self.slot // 20 * 960, 1, 20)
                if self.slot % 33 == 0:
                    parts = 1 if side == "ground" else self.random.choice((2, 3))
                    self.put(side, "video", 1, self.slot * 90, parts, 300)
            for gateway, event in self.link.step():
                self.take("space" if gateway is self.link.space else "ground", event)
            self.slot += 1

    def put(self, side, flow, unit, timestamp, parts, octets):
        gateway, source = getattr(self.link, side), self.sources[side][flow]
        for part in range(parts):
            source[0] += 1
            marker = 0x80 if flow == "video" and part == parts - 1 else 0
            stamp = source[1] + timestamp & 0xFFFF_FFFF
            fields = (0x80, marker | 96, source[0] & 0xFFFF, stamp, source[2])
            payload = struct.pack(">QB", self.slot, part) + bytes(octets)
            packet = struct.pack(">BBHII", *fields) + payload
            self.sent[side, flow, payload[:9]] = packet
            gateway.handle_datagram(flow, packet, self.link.now_ns)

    def take(self, side, event):
        if not hasattr(event, "flow"):
            return
        other = "ground" if side == "space" else "space"
        # The payload says which packet it is; the header must belong to it.
        key = (other, event.flow.name, event.data[12:21])
        assert event.data == self.sent[key]
        assert key[2] > self.last.get(key[:2], b"")
        self.last[key[:2]] = key[2]
        self.received += 1

    def headers(self, side):
        return getattr(self.link, side).report(self.link.now_ns).transmit.headers

    def dropped(self):
        return {
            side: getattr(self.link, side).report(self.link.now_ns).receive.packets_dropped
            for side in ("ground", "space")
        }


@pytest.mark.parametrize("delay_ms", [0, 12, 350])
def test_headers_cost_two_octets_on_average_two_way(delay_ms):
    session = Session(delay_ms, 1)
    session.run(3000)
    before = {side: session.headers(side) for side in ("ground", "space")}
    session.run(20_000)
    octets = packets = 0
    for side, flows in before.items():
        for flow, counts in flows.items():
            now = session.headers(side)[flow]
            octets += now["header_octets"] - counts["header_octets"]
            packets += now["packets"] - counts["packets"]
            assert now["raw"] - counts["raw"] <= 30
    print(f"{octets / packets:.2f}")
    assert octets <= 2.2 * packets
    assert not any("no_context" in drops for drops in session.dropped().values())


@pytest.mark.parametrize("seed", range(4))
def test_losses_and_restarts_never_corrupt_a_packet(seed):
    session = Session([0, 12, 120, 350][seed], seed)
    random = Random(seed)
    for _ in range(40):
        session.up.loss, session.down.loss = (
            random.choice((0, 0, 0, 0.02, 0.3, 1)),
            random.choice((0, 0, 0, 0.02, 0.3, 1)),
        )
        match random.randrange(6):
            case 0:
                session.new_life(random.choice(("ground", "space")))
            case 1:
                session.new_source(random.choice(("ground", "space")))
        session.run(random.choice((30, 200, 700, 1500)))
    assert session.received > 500


def test_a_restart_during_a_gap_is_recognized():
    """The new life continues the frame count as if frames had been lost, with the same numbers.

    The peer could acknowledge a context that this life never sent.
    """
    for slots in range(20, 400, 12):
        session = Session(5, slots)
        session.run(1000)
        session.up.loss = session.down.loss = 1
        session.new_life("ground")
        session.run(1200 + slots)
        session.up.loss = session.down.loss = 0
        # The first contexts of the new life are lost now.
        session.run(40)
        session.up.loss = 0.7
        session.run(300)
        session.up.loss = 0
        session.run(300)
