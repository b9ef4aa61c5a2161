"""Delays, headers, goodput and recovery of the link on virtual time, with a session's gateways."""

import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from random import Random

from virtual_link import VirtualLink

from kontur_av.clock import NS_PER_MS, NS_PER_S
from pipelines.bench.link import COMMANDS, FILE, FLOWS, VIDEO, VOICE, Talker
from telepresence.link.flows import HapticReceived, Level, PacketReceived
from telepresence.link.gateway import Gateway
from telepresence.link.profile import LinkProfile
from telepresence.link.radio import RadioPath, RadioProfile
from telepresence.link.radio.profile import Blackout
from telepresence.link.supervision.message import LinkState

#: Octets that keep a queue from running empty.
_ENOUGH = 2048
#: After this the negotiation is over, and supervision messages are rare.
_LEAD_IN_NS = 3 * NS_PER_S


def _saturate(gateway: Gateway, talkers: Sequence[Talker], now_ns: int) -> None:
    """Fill the queue of every level."""
    sender = gateway.sender
    for flow in FLOWS:
        while sender.waiting_octets(flow.level) < _ENOUGH:
            talker = next((talker for talker in talkers if talker.flow == flow.name), None)
            data = bytes(200) if talker is None else talker.packet(now_ns)
            if not gateway.handle_datagram(flow.name, data, now_ns):
                break


def haptic_delays(seconds: float, *, saturated: bool, radio: Sequence[RadioPath]) -> list[int]:
    """One-way delay (ns) of every sample of both directions, in order; -1 for a lost one.

    radio: the path up and the path down. A sample is offered at the instant of its slot.
    """
    link = VirtualLink(uplink_flows=FLOWS, downlink_flows=FLOWS, up=radio[0], down=radio[1])
    talkers = (Talker(VOICE, 19), Talker(VIDEO, 354))
    slots = round(seconds * NS_PER_S / link.slot_ns)
    delays = [-1] * (2 * slots)
    for slot in range(slots):
        now_ns = link.now_ns
        for side, gateway in enumerate((link.ground, link.space)):
            gateway.handle_haptic(struct.pack(">IQ", 2 * slot + side, now_ns), now_ns)
            if saturated:
                _saturate(gateway, talkers, now_ns)
        for _, event in link.step():
            if isinstance(event, HapticReceived):
                index, sent_ns = struct.unpack(">IQ", event.sample)
                delays[index] = event.now_ns - sent_ns
    return delays


@dataclass(frozen=True)
class HapticDifference:
    """The delays of samples on an idle link and on a saturated one.

    samples: number of pairs. largest_slots: the largest difference between the two delays of a
    sample. delay_ms: least and largest on the idle link.
    """

    samples: int
    largest_slots: float
    delay_ms: tuple[float, float]


def haptic_difference(seconds: float, *, delay_ns: int) -> HapticDifference:
    """Compare every sample that arrived in both runs; delay_ns: one-way delay of the radio."""
    alone, beside = (
        haptic_delays(
            seconds,
            saturated=saturated,
            radio=[RadioPath(delay_ns=delay_ns), RadioPath(delay_ns=delay_ns)],
        )
        for saturated in (False, True)
    )
    pairs = [pair for pair in zip(alone, beside, strict=True) if min(pair) >= 0]
    arrived = [first for first, _ in pairs]
    return HapticDifference(
        len(pairs),
        max(abs(first - second) for first, second in pairs) / NS_PER_MS,
        (min(arrived) / NS_PER_MS, max(arrived) / NS_PER_MS),
    )


def voice_waits(seconds: float, profile: LinkProfile, *, seed: int = 1) -> list[int]:
    """The wait (ns) of each voice packet for its first slot, with endless video and files.

    The packets come every 20 ms and up to 5 ms later, at any instant between two slots.
    """
    random = Random(seed)
    link = VirtualLink(uplink_flows=FLOWS, downlink_flows=FLOWS, uplink=profile, downlink=profile)
    gateway, voice, video = link.ground, Talker(VOICE, 19), Talker(VIDEO, 354)
    waits: list[int] = []
    next_ns, came_ns = random.randrange(20 * NS_PER_MS), None
    count = 0
    end_ns = round(seconds * NS_PER_S)
    while link.now_ns < end_ns:
        now_ns = link.now_ns
        gateway.handle_haptic(bytes(12), now_ns)
        while gateway.sender.waiting_octets(Level.VIDEO) < _ENOUGH:
            gateway.handle_datagram(VIDEO, video.packet(now_ns), now_ns)
        while gateway.sender.waiting_octets(Level.MAINTENANCE) < _ENOUGH:
            gateway.handle_datagram(FILE, bytes(200), now_ns)
        if came_ns is None and next_ns <= now_ns:
            came_ns = next_ns
            gateway.handle_datagram(VOICE, voice.packet(came_ns), came_ns)
            count += 1
            next_ns = count * 20 * NS_PER_MS + random.randrange(5 * NS_PER_MS)
        for _ in link.step():
            pass
        if came_ns is not None and not gateway.sender.waiting_octets(Level.VOICE):
            waits.append(now_ns - came_ns)
            came_ns = None
    return waits


@dataclass(frozen=True)
class Goodput:
    """The goodput of one kind of endless traffic in one direction, with haptic samples or without.

    octets: of a payload. zone_bps: rate that the frames leave to the levels below haptics.
    payload_bps: of the UDP payloads that came out; for RTP with its 12 octets of header, which
    travel compressed. packets (with tags and headers), framing, supervision, idle: shares of the
    zone.
    """

    direction: str
    flow: str
    octets: int
    haptics: bool
    zone_bps: int
    payload_bps: int
    packets: float
    framing: float
    supervision: float
    idle: float

    def shares(self) -> tuple[float, float, float, float]:
        return self.packets, self.framing, self.supervision, self.idle


def goodput(
    seconds: float, profile: LinkProfile, *, flow: str, payload_octets: int, haptics: bool
) -> Goodput:
    """Saturate `flow` with packets of `payload_octets` for `seconds`."""
    link = VirtualLink(uplink_flows=FLOWS, downlink_flows=FLOWS, uplink=profile, downlink=profile)
    gateway = link.ground
    talker = Talker(flow, payload_octets)
    level = next(known.level for known in FLOWS if known.name == flow)
    received = 0
    before: dict[str, int] = {}
    end_ns = _LEAD_IN_NS + round(seconds * NS_PER_S)
    while link.now_ns < end_ns:
        now_ns = link.now_ns
        link.space.handle_haptic(bytes(12), now_ns)
        if haptics:
            gateway.handle_haptic(bytes(12), now_ns)
        if now_ns >= _LEAD_IN_NS and not before:
            before, received = gateway.sender.octets(), 0
        while gateway.sender.waiting_octets(level) < _ENOUGH:
            data = talker.packet(now_ns) if flow in (VOICE, VIDEO) else bytes(payload_octets)
            gateway.handle_datagram(flow, data, now_ns)
        for receiver, event in link.step():
            if receiver is link.space and isinstance(event, PacketReceived):
                received += len(event.data)
    octets = {kind: count - before[kind] for kind, count in gateway.sender.octets().items()}
    zone = sum(octets.values()) - octets["header"] - octets["fecf"] - octets["haptic"]
    carried = octets[level.name.lower()] + octets["packet_headers"]
    others = (octets[kind] / zone for kind in ("framing", "supervision", "idle"))
    rates = round(zone * 8 / seconds), round(received * 8 / seconds)
    return Goodput(profile.name, flow, payload_octets, haptics, *rates, carried / zone, *others)


@dataclass(frozen=True)
class HeaderOctets:
    """Octets of the headers of a flow on the link, tags included.

    packets, whole: number of packets, and of those with a whole header or a wide one. mean:
        over all packets.
    most_compressed: the largest compressed header.
    """

    packets: int
    whole: int
    mean: float
    most_compressed: int


def header_octets(seconds: float, *, seed: int = 1) -> dict[str, HeaderOctets]:
    """Headers of the streams of `spacejustin`, each offered with the jitter of a real program.

    Pictures are captured 30 times a second, at most 1 ms late, and are encoded for 3 to 12 ms;
    voice is handed over 0 to 3 ms late. On the uplink a picture is one packet, on the downlink
    three of one instant.
    """
    link = VirtualLink(uplink_flows=FLOWS, downlink_flows=FLOWS)
    random = Random(seed)
    sides = (("uplink", link.ground, 1, 345), ("downlink", link.space, 3, 710))
    due: list[tuple[int, Gateway, str, bytes]] = []
    for _, gateway, packets, octets in sides:
        due += _picture_packets(gateway, packets, octets, seconds, random)
        due += _voice_packets(gateway, seconds, random)
    due.sort(key=lambda entry: entry[0], reverse=True)
    while due:
        now_ns = link.now_ns
        while due and due[-1][0] <= now_ns:
            _, gateway, flow, data = due.pop()
            gateway.handle_datagram(flow, data, now_ns)
        for gateway in (link.ground, link.space):
            gateway.handle_haptic(bytes(12), now_ns)
        for _ in link.step():
            pass
    return {
        f"{name} {flow}": _counted(gateway.report(link.now_ns).transmit.headers[flow])
        for name, gateway, _, _ in sides
        for flow in (VIDEO, VOICE)
    }


def _picture_packets(
    gateway: Gateway, packets: int, octets: int, seconds: float, random: Random
) -> Iterator[tuple[int, Gateway, str, bytes]]:
    talker = Talker(VIDEO, octets, ssrc=random.getrandbits(32), sequence=random.getrandbits(16))
    for picture in range(round(30 * seconds)):
        captured_ns = picture * NS_PER_S // 30 + random.randrange(NS_PER_MS)
        encoded_ns = captured_ns + random.randrange(3 * NS_PER_MS, 12 * NS_PER_MS)
        for number in range(1, packets + 1):
            data = talker.packet(captured_ns, last=number == packets)
            yield encoded_ns, gateway, VIDEO, data


def _voice_packets(
    gateway: Gateway, seconds: float, random: Random
) -> Iterator[tuple[int, Gateway, str, bytes]]:
    talker = Talker(VOICE, 19, ssrc=random.getrandbits(32), sequence=random.getrandbits(16))
    for block in range(round(50 * seconds)):
        handed_ns = block * 20 * NS_PER_MS + random.randrange(3 * NS_PER_MS)
        yield handed_ns, gateway, VOICE, talker.packet(handed_ns)


#: Octets of each compressed form of a header, with the tag (`rtp_forms`). The wide form is for
#: what does not fit these; it is counted with whole headers.
_COMPRESSED = {"bare": 1, "short": 2, "near": 2, "long": 3}


def _counted(counts: Mapping[str, int]) -> HeaderOctets:
    packets = counts["packets"]
    compressed = {kind: octets for kind, octets in _COMPRESSED.items() if counts[kind]}
    return HeaderOctets(
        packets,
        packets - sum(counts[kind] for kind in compressed),
        counts["header_octets"] / max(packets, 1),
        max(compressed.values(), default=0),
    )


#: Period and payload octets of each kind of packet. Together they take nine tenths of the uplink,
#: so that packets wait for the signal and not for each other.
_OFFERS = {
    COMMANDS: (20 * NS_PER_MS, 12),
    VOICE: (20 * NS_PER_MS, 19),
    VIDEO: (33 * NS_PER_MS, 290),
}
_STAMP = struct.Struct(">Q")
#: A packet that comes out older than this is stale.
_STALE_NS = 100 * NS_PER_MS
HAPTIC = "haptic"
CONNECTED = "connected"


@dataclass
class Resumptions:
    """Recovery from blackouts of one length; durations in ns, one for each blackout and direction.

    noticed: from the last good frame to the notice that the signal is lost.
    first: from the first good frame after the blackout. Keys: the first sample (`haptic`), the
        first packet of each flow, and the end of the negotiation (`connected`).
    packets, stale: packets that came out, and those of them that were older than 100 ms plus the
        delay of the radio.
    """

    noticed: list[int] = field(default_factory=list)
    first: dict[str, list[int]] = field(
        default_factory=lambda: {name: [] for name in (HAPTIC, *_OFFERS, CONNECTED)}
    )
    packets: int = 0
    stale: int = 0


class _Offers:
    """Offers packets of every level to one segment, each stamped with its instant."""

    def __init__(self, gateway: Gateway, random: Random) -> None:
        self._gateway = gateway
        self._due_ns = {flow: random.randrange(period) for flow, (period, _) in _OFFERS.items()}
        self._talkers = {
            flow: Talker(flow, _OFFERS[flow][1] - _STAMP.size) for flow in (VOICE, VIDEO)
        }

    def handle_slot(self, now_ns: int) -> None:
        self._gateway.handle_haptic(bytes(12), now_ns)
        for flow, (period_ns, octets) in _OFFERS.items():
            due_ns = self._due_ns[flow]
            if due_ns > now_ns:
                continue
            self._due_ns[flow] = due_ns + period_ns
            talker = self._talkers.get(flow)
            data = bytes(octets - _STAMP.size) if talker is None else talker.packet(due_ns)
            self._gateway.handle_datagram(flow, data + _STAMP.pack(due_ns), now_ns)


class _Watch:
    """Watches one receiving segment through one blackout."""

    def __init__(self, gateway: Gateway, last_good_ns: int, back_ns: int) -> None:
        self._gateway = gateway
        self._last_good_ns = last_good_ns
        self._back_ns = back_ns
        self._noticed = False
        self._waiting = {HAPTIC, *_OFFERS, CONNECTED}

    def handle_arrival(self, kind: str, now_ns: int, result: Resumptions) -> None:
        if kind in self._waiting and now_ns >= self._back_ns:
            self._waiting.discard(kind)
            result.first[kind].append(now_ns - self._back_ns)

    def handle_slot(self, now_ns: int, result: Resumptions) -> None:
        supervisor = self._gateway.supervisor
        if not self._noticed and not supervisor.signal:
            self._noticed = True
            result.noticed.append(now_ns - self._last_good_ns)
        if supervisor.state is LinkState.CONNECTED:
            self.handle_arrival(CONNECTED, now_ns, result)


def resumptions(
    blackout_s: float, *, blackouts: int, delay_ns: int = 0, seed: int = 1
) -> Resumptions:
    """Run `blackouts` of `blackout_s` seconds each in both directions, 2 to 3 s apart.

    Packets of all levels are offered all the time, at phases that depend on `seed`.
    """
    random = Random(seed)
    length_ns = round(blackout_s * NS_PER_S)
    starts_ns, at_ns = [], _LEAD_IN_NS
    for _ in range(blackouts):
        starts_ns.append(at_ns + random.randrange(NS_PER_S))
        at_ns = starts_ns[-1] + length_ns + 2 * NS_PER_S
    profile = RadioProfile(
        name="blackouts",
        delay_ms=delay_ns / NS_PER_MS,
        blackouts=tuple(
            Blackout(start_s=start_ns / NS_PER_S, seconds=blackout_s) for start_ns in starts_ns
        ),
    )
    link = VirtualLink(
        uplink_flows=FLOWS,
        downlink_flows=FLOWS,
        up=profile.path("uplink", seed=seed, epoch_ns=0),
        down=profile.path("downlink", seed=seed, epoch_ns=0),
        seed=seed,
    )
    slot_ns = link.slot_ns
    result = Resumptions()
    offers = [_Offers(gateway, random) for gateway in (link.ground, link.space)]
    watches: dict[int, _Watch] = {}
    for start_ns, end_ns in zip(starts_ns, (*starts_ns[1:], at_ns), strict=True):
        # Arrival of the last slot before the blackout and of the first one after it.
        last_good_ns = -(-start_ns // slot_ns) * slot_ns - slot_ns + delay_ns
        back_ns = -(-(start_ns + length_ns) // slot_ns) * slot_ns + delay_ns
        while link.now_ns < end_ns:
            if link.now_ns >= start_ns and not watches:
                watches = {
                    id(gateway): _Watch(gateway, last_good_ns, back_ns)
                    for gateway in (link.ground, link.space)
                }
            for offer in offers:
                offer.handle_slot(link.now_ns)
            for gateway, event in link.step():
                if isinstance(event, HapticReceived):
                    kind = HAPTIC
                elif isinstance(event, PacketReceived):
                    kind = event.flow.name
                    (put_in_ns,) = _STAMP.unpack(event.data[-_STAMP.size :])
                    result.packets += 1
                    result.stale += event.now_ns - put_in_ns > _STALE_NS + delay_ns
                else:
                    continue
                watch = watches.get(id(gateway))
                if watch is not None:
                    watch.handle_arrival(kind, event.now_ns, result)
            for watch in watches.values():
                watch.handle_slot(link.now_ns, result)
        watches = {}
    return result
