"""The peer's clock through an uneven path: the stated error always holds the truth."""

from dataclasses import dataclass
from itertools import pairwise
from random import Random

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from telepresence.link.clock_exchange import (
    ClockExchange,
    ClockMessage,
    ReportClock,
    earlier,
    is_clock,
    message_mark,
    pack_clock,
    parse_clock,
)
from telepresence.link.flows import Level, PacketReceived, packet_flow, rtcp_flow
from telepresence.link.gateway import Gateway
from telepresence.link.profile import DOWNLINK, UPLINK
from telepresence.link.radio import RadioPath

MS, S, US = 1_000_000, 1_000_000_000, 1000
SLOT_NS = 10 * MS


@given(
    st.builds(
        ClockMessage,
        *(st.integers(1, 15), st.booleans(), st.integers(1, 65535)),
        *(st.integers(0, (1 << bits) - 1) for bits in (32, 8, 24, 2, 5)),
    )
)
def test_a_message_is_read_as_it_was_written(message):
    data = pack_clock(message)
    assert len(data) == 12 and is_clock(data) and parse_clock(data) == message
    assert parse_clock(data[:-1]) is None and parse_clock(data + b"\0") is None
    # No version, no life, another kind.
    for at, octets in ((0, b"\x05"), (2, b"\0\0"), (0, bytes([data[0] & 0xF0 | 4]))):
        assert parse_clock(data[:at] + octets + data[at + len(octets) :]) is None


def test_bits_are_where_the_table_says():
    message = ClockMessage(3, True, 0x0102, 0xA1B2C3D4, 0xE5, 0x00F6F7, part=2, piece=0b10110)
    assert pack_clock(message) == bytes.fromhex("35 b6 0102 a1b2c3d4 e5 00f6f7")
    assert message_mark(0xA1B2C3D4) == 0xB2


@dataclass
class Path:
    """Delays of both ways: a floor, and an exponential tail above it."""

    there_ns: int
    back_ns: int
    jitter_ns: int = 0
    loss: float = 0.0
    seed: int = 0

    def __post_init__(self):
        self.random = Random(self.seed)

    def delay_ns(self, *, there):
        if self.random.random() < self.loss:
            return None
        tail = self.random.expovariate(1 / self.jitter_ns) if self.jitter_ns else 0
        return (self.there_ns if there else self.back_ns) + round(tail)


@dataclass
class Ends:
    """Two ends on true time; the clock of the second is shifted, drifts, and may be stepped."""

    path: Path
    offset_ns: int
    drift: float = 0.0
    start_ns: int = 10**15
    #: True time and size of a step of the second clock.
    step: tuple[int, int] = (1 << 62, 0)

    def peer_ns(self, true_ns):
        shift_ns = self.offset_ns + round(self.drift * (true_ns - self.start_ns))
        return true_ns + shift_ns + (true_ns >= self.start_ns + self.step[0]) * self.step[1]

    def run(self, seconds):
        """Yield true time, the first end's estimate and the first end, twice a second."""
        clocks = (lambda now_ns: now_ns, self.peer_ns)
        ends = [
            clock(master=not number, boot_id=number + 1, now_ns=clocks[number](self.start_ns))
            for number in range(2)
        ]
        under_way = []
        for slot in range(round(seconds * S / SLOT_NS)):
            true_ns = self.start_ns + slot * SLOT_NS
            for one in sorted(one for one in under_way if one[0] <= true_ns):
                under_way.remove(one)
                came_ns, to, data = one
                assert ends[to].handle_message(data, clocks[to](came_ns), heard=True)
            for number, end in enumerate(ends):
                now_ns = clocks[number](true_ns)
                if now_ns < end.next_ns:
                    continue
                data = end.poll_transmit(now_ns, now_ns)
                delay_ns = self.path.delay_ns(there=not number)
                if delay_ns is not None:
                    under_way.append((true_ns + delay_ns, 1 - number, data))
            if slot % 50 == 49:
                yield true_ns, ends[0].estimate(true_ns), ends[0]


def ms(most: int) -> st.SearchStrategy[int]:
    return st.integers(0, most * MS)


@settings(deadline=None, max_examples=25)
# Messages overtake each other while the stamp begins anew.
@example(0, 0, 300 * MS, 0.0, 32_180_001_697, -1, 34, 371)
@given(
    there_ns=ms(300),
    back_ns=ms(300),
    jitter_ns=st.sampled_from([0, 100 * US, 20 * MS, 300 * MS]),
    loss=st.sampled_from([0.0, 0.3]),
    # As far apart as clocks that nobody set: 30 years, in both directions.
    offset_ns=st.integers(-1800 * S, 1800 * S) | st.integers(-(10**18), 10**18),
    ppm=st.integers(-50, 50),
    wraps_in_s=st.integers(0, 60),
    seed=st.integers(0, 1000),
)
def test_the_stated_error_holds_the_truth(
    there_ns, back_ns, jitter_ns, loss, offset_ns, ppm, wraps_in_s, seed
):
    # Stamps repeat every 2**32 µs, for one of the ends while this runs.
    start_ns = ((1 << 32) * 1000) * 400_000 - wraps_in_s * S + 123
    path = Path(there_ns, back_ns, jitter_ns, loss, seed)
    ends = Ends(path, offset_ns, ppm * 1e-6, start_ns)
    known = 0
    for true_ns, estimate, end in ends.run(90):
        assert end.report(true_ns).restarts == 0
        if estimate is None:
            continue
        known += 1
        truth_ns = ends.peer_ns(true_ns) - true_ns
        assert abs(truth_ns - estimate.offset_ns) <= estimate.error_ns
        assert abs(ppm * 1000 - estimate.drift_ppb) <= estimate.drift_error_ppb
    assert known > 100


@pytest.mark.parametrize(("each_ns", "jitter_ns"), [(2 * MS, 0), (MS, 2 * MS)])
def test_the_error_is_about_half_the_round_trip_and_jitter_costs_little(each_ns, jitter_ns):
    ends = Ends(Path(each_ns, each_ns, jitter_ns, seed=1), 12 * S, 50e-6)
    *_, (true_ns, estimate, _) = ends.run(60)
    assert estimate.error_ns < each_ns + 0.5 * MS
    # The delays are equal, so the middle is near the truth: within what drifted since they came.
    assert abs(ends.peer_ns(true_ns) - true_ns - estimate.offset_ns) < 120 * US + jitter_ns
    assert estimate.drift_error_ppb < 200_000


@pytest.mark.parametrize("step_ns", [5 * S, -5 * S, 3 * MS])
def test_a_step_and_a_new_life_of_the_peer_begin_the_estimate_anew(step_ns):
    ends = Ends(Path(MS, MS), S, step=(20 * S, step_ns))
    *_, (true_ns, estimate, end) = ends.run(40)
    assert end.report(true_ns).restarts == 1
    assert abs(ends.peer_ns(true_ns) - true_ns - estimate.offset_ns) <= estimate.error_ns
    end.handle_peer(7, true_ns)
    assert end.estimate(true_ns) is None
    assert end.next_ns == true_ns


def clock(*, master=True, boot_id=1, now_ns=0, told_offset_ns=0, version=3):
    end = ClockExchange(
        version=version,
        master=master,
        boot_id=boot_id,
        told_offset_ns=told_offset_ns,
        now_ns=now_ns,
    )
    end.handle_peer(3 - boot_id, now_ns)
    return end


def test_what_is_not_the_peers_is_refused():
    data = clock(master=False, boot_id=2).poll_transmit(0, 0)
    assert clock().handle_message(data, 0, heard=True)
    for other in (clock(master=False), clock(boot_id=2), clock(version=2)):
        assert not other.handle_message(data, 0, heard=True)


def test_a_clock_that_was_just_met_is_told_more_often():
    end, sent = clock(now_ns=S), []
    for ms in range(1000, 15_000, 10):
        if ms * MS >= end.next_ns:
            end.poll_transmit(ms * MS, ms * MS)
            sent.append(ms)
        if ms == 12_000:
            end.handle_peer(2, ms * MS)  # the same one
    # Twenty at 250 ms, later every 2 s: what docs/wire-formats.md says.
    steps = [b - a for a, b in pairwise(sent)]
    assert sent[0] == 1000 and steps == [250] * 20 + [2000] * (len(steps) - 20)
    assert end.report(15 * S).messages_sent == len(sent)
    end.handle_peer(9, 15 * S)
    assert end.next_ns == 15 * S
    end.poll_transmit(15 * S, 15 * S)
    assert end.next_ns == 15_250 * MS


def test_a_message_says_when_it_leaves_and_how_old_the_peers_newest_is():
    end = clock(told_offset_ns=7 * S)
    first = parse_clock(end.poll_transmit(0, 2 * MS))
    assert (first.stamp_us, first.age_us, first.mark, first.part) == (7_002_000, 0xFFFFFF, 0, 0)
    peer = pack_clock(ClockMessage(3, False, 2, 0x00AB_0000))
    assert end.handle_message(peer, 10 * MS + 1, heard=True)
    second = parse_clock(end.poll_transmit(30 * MS, 31 * MS))
    # It came within a microsecond that is counted whole.
    assert (second.mark, second.age_us, second.part) == (0xAB, 31_000 - 10_001, 1)
    ages = [parse_clock(end.poll_transmit(ns, ns)).age_us for ns in (16_787 * MS, 16_788 * MS)]
    assert ages == [16_787_000 - 10_001, 0xFFFFFF]
    # One that leaves before the peer's came is told nothing of it.
    assert end.handle_message(peer, 40 * S, heard=True)
    assert parse_clock(end.poll_transmit(39 * S, 39 * S)).age_us == 0xFFFFFF
    parts = [parse_clock(end.poll_transmit(ns, ns)).part for ns in range(5)]
    assert [(b - a) % 4 for a, b in pairwise(parts)] == [1] * 4


@pytest.mark.parametrize("heard", [True, False])
def test_an_end_that_is_not_heard_has_no_offset(heard):
    one, other = clock(), clock(master=False, boot_id=2)
    for number in range(12):
        # The other clock is 5 s ahead; 3 ms there, 1 ms back.
        now_ns, there_ns = number * 250 * MS, number * 250 * MS + 5 * S + 3 * MS
        assert other.handle_message(one.poll_transmit(now_ns, now_ns), there_ns, heard=True)
        back = other.poll_transmit(there_ns, there_ns)
        assert one.handle_message(back, now_ns + 4 * MS, heard=heard)
    estimate, report = one.estimate(3 * S), one.report(3 * S)
    assert (estimate is not None) is (report.offset_ns is not None) is heard
    if estimate is not None:
        assert estimate.offset_ns == pytest.approx(5 * S + MS, abs=0.2 * MS)
        assert 2 * MS <= estimate.error_ns < 2.3 * MS
    assert report.messages_received == 12


@given(st.lists(st.tuples(st.binary(min_size=8, max_size=8), st.integers(0, 10**9)), max_size=60))
def test_any_clocks_of_the_peer_are_taken_or_begun_anew(told):
    exchange, now_ns = clock(version=2), 0
    for rest, later_ns in told:
        now_ns += later_ns
        exchange.poll_transmit(now_ns, now_ns)
        assert exchange.handle_message(bytes.fromhex("25000002") + rest, now_ns, heard=True)
        found = exchange.estimate(now_ns)
        assert found is None or found.error_ns > 0
    metrics = exchange.report(now_ns)
    assert metrics.messages_received == len(told) and metrics.restarts <= len(told) + 1


def report_of(seconds, fraction=0):
    """A sender report (RFC 3550, 6.4.1) with this NTP timestamp."""
    ntp = (seconds << 32 | fraction).to_bytes(8, "big")
    return bytes.fromhex("80c80006 11223344") + ntp + bytes(range(12))


def test_a_sender_report_is_made_earlier_and_nothing_else():
    moved = earlier(report_of(3_000_000_000, 1 << 31), 1_250_000_000)
    assert moved == report_of(2_999_999_999, 1 << 30)
    assert earlier(report_of(5), -2 * S) == report_of(7)
    # Before the epoch of NTP it wraps.
    assert earlier(report_of(0), S) == report_of((1 << 32) - 1)
    receiver_report = b"\x80\xc9" + report_of(5)[2:]
    for packet in (receiver_report, report_of(5)[:15], b""):
        assert earlier(packet, S) == packet
    assert earlier(report_of(5)[:16], S) == report_of(4)[:16]
    assert earlier(report_of(5), 0) == report_of(5)


class Peer:
    """In the place of a `ClockExchange`."""

    def __init__(self):
        self.offset_ns = None

    def estimate(self, now_ns):
        return None if self.offset_ns is None else self


def packets(reports):
    found = []
    while (event := reports.next_event()) is not None:
        found.append((event.flow.name, event.data, event.now_ns))
    return found


def test_a_report_waits_three_seconds_for_the_peers_clock():
    peer = Peer()
    reports = ReportClock(peer)
    reports.handle_time(0)
    reports.handle_report(PacketReceived(rtcp_flow("a"), report_of(9), S))
    reports.handle_report(PacketReceived(rtcp_flow("a"), report_of(10), 2 * S))
    reports.handle_report(PacketReceived(rtcp_flow("b"), report_of(20), 2 * S))
    reports.handle_time(4 * S - 1)
    assert packets(reports) == []
    # Then the newest of each flow comes as it is.
    reports.handle_time(4 * S)
    assert packets(reports) == [("a", report_of(10), 4 * S), ("b", report_of(20), 4 * S)]
    reports.handle_report(PacketReceived(rtcp_flow("a"), report_of(11), 9 * S))
    assert packets(reports) == []
    peer.offset_ns = 2 * S
    reports.handle_time(9 * S + 1)
    assert packets(reports) == [("a", report_of(9), 9 * S + 1)]
    reports.handle_report(PacketReceived(rtcp_flow("a"), report_of(12), 10 * S))
    assert packets(reports) == [("a", report_of(10), 10 * S)]


def test_at_most_eight_reports_are_held():
    reports = ReportClock(Peer())
    for number in range(10):
        reports.handle_report(PacketReceived(rtcp_flow(str(number)), report_of(number), 0))
    reports.handle_time(3 * S)
    assert [name for name, *_ in packets(reports)] == list("01234567")


UP = [packet_flow("tc", Level.TMTC)]
DOWN = [packet_flow("tm", Level.TMTC), rtcp_flow("rtcp")]
#: Of the network, besides what the radio paths of both ends add.
NETWORK_NS = 300_000


class Gateways:
    """Ground, whose clock is right, and space, whose clock is ahead and drifts."""

    def __init__(self, ahead_ns=0, drift=0.0, radio_ns=(0, 0), *, compare=True):
        self.ahead_ns, self.drift, self.radio_ns = ahead_ns, drift, radio_ns
        self.compare = compare
        self.true_ns = 0
        self.way_in = None
        #: Packets that came out on the ground.
        self.on_ground = []
        self.space, self.ground = self.gateway(1), self.gateway(2)

    def gateway(self, boot_id):
        ground = boot_id > 1
        ways = ((UPLINK, UP), (DOWNLINK, DOWN))
        (transmit, sent), (receive, received) = ways if ground else ways[::-1]
        return Gateway(
            transmit=transmit,
            transmit_flows=sent,
            receive=receive,
            receive_flows=received,
            master=ground,
            boot_id=boot_id,
            now_ns=0 if ground else self.space_ns(0),
            radio=RadioPath(delay_ns=self.radio_ns[not ground]),
            told_offset_ns=0 if self.compare else None,
            secret=boot_id,
        )

    def space_ns(self, true_ns):
        return true_ns + self.ahead_ns + round(true_ns * self.drift)

    def clock_of(self, end):
        """Its figures, and by how much its offset is wrong."""
        away_ns = self.space_ns(self.true_ns) - self.true_ns
        if end is self.ground:
            metrics = end.report(self.true_ns).clock
            return metrics, abs(metrics.offset_ns - away_ns)
        metrics = end.report(self.space_ns(self.true_ns)).clock
        return metrics, abs(metrics.offset_ns + away_ns)

    def take(self, end, frame, now_ns):
        end.handle_radio(frame, now_ns)
        events = list(iter(end.next_event, None))
        if end is self.ground:
            self.on_ground += [event for event in events if isinstance(event, PacketReceived)]

    def run(self, seconds):
        end_ns = self.true_ns + round(seconds * S)
        on_the_way = []
        while self.true_ns < end_ns:
            self.ground.handle_slot(self.true_ns)
            self.space.handle_slot(self.space_ns(self.true_ns))
            # The radio's frames leave at the next tenth of a slot.
            for at_ns in range(self.true_ns, self.true_ns + MS, MS // 10):
                now_ns = self.space_ns(at_ns)
                for near, far, near_ns in (
                    (self.ground, self.space, at_ns),
                    (self.space, self.ground, now_ns),
                ):
                    while (frame := near.poll_transmit(near_ns)) is not None:
                        on_the_way.append((at_ns + NETWORK_NS, far, frame))
                while on_the_way and on_the_way[0][0] <= at_ns:
                    came_ns, far, frame = on_the_way.pop(0)
                    if far is self.ground:
                        self.take(far, frame, came_ns)
                    elif self.way_in is None:
                        self.take(far, frame, self.space_ns(came_ns))
                    else:
                        self.way_in.handle_frame(frame, self.space_ns(came_ns))
                while self.way_in is not None and (frame := self.way_in.poll_transmit(now_ns)):
                    self.take(self.space, frame, now_ns)
            self.true_ns += MS


@pytest.mark.rule("5")
@pytest.mark.parametrize("radio_ns", [(0, 0), (250 * MS, 10 * MS)])
def test_both_ends_find_the_offset_whatever_the_radio_delays(radio_ns):
    pair = Gateways(12 * S, 50e-6, radio_ns)
    pair.run(12)
    for end in (pair.ground, pair.space):
        metrics, wrong_ns = pair.clock_of(end)
        assert wrong_ns <= metrics.error_ns < 2 * NETWORK_NS
    ground, space = (pair.clock_of(end)[0] for end in (pair.ground, pair.space))
    # 20 at first, then one every two seconds.
    assert 20 < ground.messages_sent < 26
    assert ground.messages_received in (space.messages_sent, space.messages_sent - 1)


def test_a_radio_on_the_way_in_is_no_part_of_the_network():
    pair = Gateways(12 * S)
    pair.way_in = pair.space.radio_in = RadioPath(delay_ns=10 * MS)
    pair.run(6)
    metrics, wrong_ns = pair.clock_of(pair.space)
    assert wrong_ns <= metrics.error_ns < 2 * NETWORK_NS


def test_a_restarted_peer_is_measured_anew():
    pair = Gateways(S)
    pair.run(3)
    pair.ground = pair.gateway(3)
    pair.run(3)
    metrics, wrong_ns = pair.clock_of(pair.space)
    assert wrong_ns <= metrics.error_ns < MS
    assert metrics.restarts == 0


def test_ends_of_one_machine_send_no_clock_and_an_end_that_compares_none_drops_it():
    pair, silent = Gateways(), Gateways(compare=False)
    pair.run(3)
    silent.run(3)
    assert silent.ground.report(silent.true_ns).clock is None
    counts = [one.ground.report(one.true_ns).supervision.counts for one in (pair, silent)]
    assert counts[0] == counts[1]
    octets = [one.ground.sender.octets()["supervision"] for one in (pair, silent)]
    assert octets[0] > octets[1]
    pair.space.clock = None
    pair.run(2)
    supervision = pair.space.report(pair.true_ns).supervision
    assert supervision.counts["messages_malformed"] > 3
    assert pair.ground.report(pair.true_ns).clock is not None
    assert supervision.state == "approve"


def test_sender_reports_come_out_in_the_own_wall_time_and_wait_for_the_clock_not_for_ever():
    pair = Gateways(12 * S, 50e-6)
    pair.run(2)

    def put():
        now_ns = pair.space_ns(pair.true_ns)
        packet = report_of(now_ns // S, (now_ns % S << 32) // S)
        assert pair.space.handle_datagram("rtcp", packet, now_ns)
        return pair.true_ns, packet

    sent_ns, packet = put()
    pair.run(0.1)
    (event,) = pair.on_ground
    told_ns = int.from_bytes(event.data[8:16], "big") * S >> 32
    assert abs(told_ns - sent_ns) < MS
    assert event.data[16:] == packet[16:]
    pair.ground.clock.handle_peer(9, pair.true_ns)  # as if another life had come
    _, packet = put()
    pair.run(1)
    assert len(pair.on_ground) == 1
    pair.run(4)
    assert pair.on_ground[1].data == packet
