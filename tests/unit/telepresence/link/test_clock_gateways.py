"""Two gateways with a clock each: what they find out, and what it costs the link."""

from dataclasses import dataclass

import pytest

from kontur_av.clock import NS_PER_MS, NS_PER_S
from telepresence.link.clock_exchange import earlier
from telepresence.link.flows import Level, LinkEvent, PacketReceived, packet_flow, rtcp_flow
from telepresence.link.gateway import Gateway
from telepresence.link.profile import DOWNLINK, UPLINK
from telepresence.link.radio import RadioPath

UP = [packet_flow("tc", Level.TMTC)]
DOWN = [packet_flow("tm", Level.TMTC), rtcp_flow("rtcp")]
#: Of the network, besides what the radio paths of both ends add.
NETWORK_NS = 300_000


@dataclass
class Pair:
    """Ground, whose clock is right, and space, whose clock is ahead and drifts."""

    ahead_ns: int
    drift: float
    radio_ns: tuple[int, int]
    compare: bool = True

    def __post_init__(self) -> None:
        self.lives = 2
        self.way_in: RadioPath | None = None
        #: Packets that came out on the ground.
        self.on_ground: list[PacketReceived] = []
        self.ground = self._ground()
        self.space = Gateway(
            transmit=DOWNLINK,
            transmit_flows=DOWN,
            receive=UPLINK,
            receive_flows=UP,
            master=False,
            life=1,
            now_ns=self.space_ns(0),
            radio=RadioPath(delay_ns=self.radio_ns[1]),
            told_offset_ns=0 if self.compare else None,
            secret=1,
        )
        self.true_ns = 0

    def _ground(self) -> Gateway:
        self.lives += 1
        return Gateway(
            transmit=UPLINK,
            transmit_flows=UP,
            receive=DOWNLINK,
            receive_flows=DOWN,
            master=True,
            life=self.lives,
            now_ns=0,
            radio=RadioPath(delay_ns=self.radio_ns[0]),
            told_offset_ns=0 if self.compare else None,
            secret=2,
        )

    def _take(self, end: Gateway, frame: bytes, now_ns: int) -> None:
        end.handle_radio(frame, now_ns)
        while (event := end.next_event()) is not None:
            self._note(end, event)

    def _note(self, end: Gateway, event: LinkEvent) -> None:
        if end is self.ground and isinstance(event, PacketReceived):
            self.on_ground.append(event)

    def restart_ground(self) -> None:
        self.ground = self._ground()

    def space_ns(self, true_ns: int) -> int:
        return true_ns + self.ahead_ns + round(true_ns * self.drift)

    def run(self, seconds: float) -> None:
        end_ns = self.true_ns + round(seconds * NS_PER_S)
        on_the_way: list[tuple[int, Gateway, bytes]] = []
        while self.true_ns < end_ns:
            true_ns = self.true_ns
            self.ground.handle_slot(true_ns)
            self.space.handle_slot(self.space_ns(true_ns))
            # The radio's frames leave at the next tenth of a slot.
            for tenth in range(10):
                at_ns = true_ns + tenth * NS_PER_MS // 10
                for near, far, now_ns in (
                    (self.ground, self.space, at_ns),
                    (self.space, self.ground, self.space_ns(at_ns)),
                ):
                    while (frame := near.poll_transmit(now_ns)) is not None:
                        on_the_way.append((at_ns + NETWORK_NS, far, frame))
                while on_the_way and on_the_way[0][0] <= at_ns:
                    came_ns, far, frame = on_the_way.pop(0)
                    if far is self.space and self.way_in is not None:
                        self.way_in.handle_frame(frame, self.space_ns(came_ns))
                    else:
                        self._take(
                            far, frame, came_ns if far is self.ground else self.space_ns(came_ns)
                        )
                now_ns = self.space_ns(at_ns)
                while self.way_in is not None and (frame := self.way_in.poll_transmit(now_ns)):
                    self._take(self.space, frame, now_ns)
            self.true_ns += NS_PER_MS


@pytest.mark.parametrize("radio_ns", [(0, 0), (250 * NS_PER_MS, 10 * NS_PER_MS)])
def test_both_ends_find_the_offset_whatever_the_radio_delays(radio_ns: tuple[int, int]) -> None:
    pair = Pair(12 * NS_PER_S, 50e-6, radio_ns)
    pair.run(12)
    truth_ns = pair.space_ns(pair.true_ns) - pair.true_ns
    ground = pair.ground.report(pair.true_ns).clock
    space = pair.space.report(pair.space_ns(pair.true_ns)).clock
    assert ground is not None and ground.offset_ns is not None and ground.error_ns is not None
    assert space is not None and space.offset_ns is not None and space.error_ns is not None
    assert abs(ground.offset_ns - truth_ns) <= ground.error_ns < 2 * NETWORK_NS
    assert abs(space.offset_ns + truth_ns) <= space.error_ns < 2 * NETWORK_NS
    # 20 at first, then one every two seconds.
    assert 20 < ground.messages_sent < 26
    assert ground.messages_received in (space.messages_sent, space.messages_sent - 1)


def test_a_radio_on_the_way_in_is_no_part_of_the_network() -> None:
    pair = Pair(12 * NS_PER_S, 0.0, (0, 0))
    pair.way_in = pair.space.radio_in = RadioPath(delay_ns=10 * NS_PER_MS)
    pair.run(6)
    truth_ns = pair.space_ns(pair.true_ns) - pair.true_ns
    clock = pair.space.report(pair.space_ns(pair.true_ns)).clock
    assert clock is not None and clock.offset_ns is not None and clock.error_ns is not None
    assert abs(clock.offset_ns + truth_ns) <= clock.error_ns < 2 * NETWORK_NS


def test_a_restarted_peer_is_measured_anew() -> None:
    pair = Pair(NS_PER_S, 0.0, (0, 0))
    pair.run(3)
    pair.restart_ground()
    pair.run(3)
    clock = pair.space.report(pair.space_ns(pair.true_ns)).clock
    assert clock is not None and clock.offset_ns is not None and clock.error_ns is not None
    assert abs(clock.offset_ns + NS_PER_S) <= clock.error_ns < NS_PER_MS
    assert clock.restarts == 0


def test_ends_of_one_machine_send_no_clock() -> None:
    pair, silent = Pair(0, 0.0, (0, 0)), Pair(0, 0.0, (0, 0), compare=False)
    pair.run(3)
    silent.run(3)
    assert silent.ground.report(silent.true_ns).clock is None
    counts = [one.ground.report(one.true_ns).supervision.counts for one in (pair, silent)]
    assert counts[0] == counts[1]
    octets = [one.ground.sender.octets()["supervision"] for one in (pair, silent)]
    assert octets[0] > octets[1]


def test_an_end_that_compares_no_clocks_drops_the_message() -> None:
    pair = Pair(0, 0.0, (0, 0))
    pair.space.clock = None
    pair.run(2)
    supervision = pair.space.report(pair.true_ns).supervision
    assert supervision.counts["messages_malformed"] > 3
    assert pair.ground.report(pair.true_ns).clock is not None
    assert supervision.state == "approve"


def report(unix_ns: int) -> bytes:
    """An RTCP sender report of this instant."""
    head = bytes((0x80, 200, 0, 6)) + (7).to_bytes(4, "big")
    return head + ((unix_ns << 32) // NS_PER_S).to_bytes(8, "big") + bytes(12)


def told_ns(packet: bytes) -> int:
    return int.from_bytes(packet[8:16], "big") * NS_PER_S >> 32


def test_sender_reports_come_out_in_the_own_wall_time() -> None:
    pair = Pair(12 * NS_PER_S, 50e-6, (0, 0))
    pair.run(2)
    sent_ns = pair.true_ns
    packet = report(pair.space_ns(sent_ns))
    assert pair.space.handle_datagram("rtcp", packet, pair.space_ns(sent_ns))
    pair.run(0.1)
    (event,) = pair.on_ground
    assert abs(told_ns(event.data) - sent_ns) < NS_PER_MS
    assert event.data[16:] == packet[16:]


def test_reports_wait_for_the_clock_but_not_for_ever() -> None:
    pair = Pair(12 * NS_PER_S, 0.0, (0, 0))
    pair.run(0.5)
    assert pair.ground.clock is not None
    pair.ground.clock.handle_peer(9, pair.true_ns)  # as if another life had come
    packet = report(pair.space_ns(pair.true_ns))
    assert pair.space.handle_datagram("rtcp", packet, pair.space_ns(pair.true_ns))
    pair.run(1)
    assert pair.on_ground == []
    pair.run(4)
    (event,) = pair.on_ground
    assert event.data == packet


@pytest.mark.parametrize("by_ns", [12 * NS_PER_S + 345, -5 * NS_PER_S])
def test_only_the_time_of_a_sender_report_is_changed(by_ns: int) -> None:
    packet = report(1_700_000_000 * NS_PER_S)
    changed = earlier(packet, by_ns)
    assert abs(told_ns(packet) - told_ns(changed) - by_ns) <= 1
    assert changed[:8] == packet[:8] and changed[16:] == packet[16:]
    other = bytes((0x81, 206)) + packet[2:]
    assert earlier(other, by_ns) == other
    assert earlier(packet[:12], by_ns) == packet[:12]
