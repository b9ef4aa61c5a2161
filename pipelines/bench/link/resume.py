"""Recovery of the link after a blackout, and the age of what comes out of it. A core."""

import struct
from dataclasses import dataclass, field
from random import Random

from kontur_av.clock import NS_PER_MS, NS_PER_S
from pipelines.bench.link.virtual import COMMANDS, FLOWS, VIDEO, VOICE, Talker
from pipelines.report.result import Percentiles, spread
from telepresence.link.flows import HapticReceived, PacketReceived
from telepresence.link.gateway import Gateway
from telepresence.link.radio import RadioProfile
from telepresence.link.radio.profile import Blackout
from telepresence.link.supervision.message import LinkState
from telepresence.link.virtual import VirtualLink

#: Period and payload octets of each kind of packet. Together they take nine tenths of the uplink,
#: so that packets wait for the signal and not for each other.
_OFFERS = {
    COMMANDS: (20 * NS_PER_MS, 12),
    VOICE: (20 * NS_PER_MS, 19),
    VIDEO: (33 * NS_PER_MS, 290),
}
_STAMP = struct.Struct(">Q")
_LEAD_IN_NS = 3 * NS_PER_S
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

    @property
    def times_ms(self) -> dict[str, Percentiles]:
        """By event."""
        times = {"loss noticed (from the last good frame)": self.noticed, **self.first}
        return {name: spread(ns, per_unit=NS_PER_MS) for name, ns in times.items()}


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
