"""Whole packets of a stream of which some zones come late or never. No I/O, no clock.

A lost zone delays only the packets that it touches:

    zones      read ................ [lost] zone zone [lost] zone zone zone
    settled    ------------------->|
    ahead      ------------------------------------------------------------->

`settled` reads in order up to the oldest zone that may still be restored. `ahead` reads all that
came, with lost zones as losses. When a zone is restored, everything behind `settled` is read again,
so each header meets the contexts that its sender assumed; some zones in each slot, to bound its
work. A packet is known by its place in the stream, so it comes out once.
"""

from telepresence.link.flows import FlowKind, Level
from telepresence.link.frame import Pointers
from telepresence.link.link_metrics import RepairMetrics
from telepresence.link.profile import LinkProfile
from telepresence.link.reassembly import PLACE_SHIFT, PacketReassembly
from telepresence.link.repair.codes import WINDOW
from telepresence.link.repair.decoder import RepairDecoder
from telepresence.link.repair.symbols import Content, Symbols

#: Voice that comes later than this is of no use, and late packets raise the playout delay.
VOICE_LATE_NS = 10_000_000
#: Zones read in one slot.
_MOST_ZONES = 32
#: A slot without packets.
_NOTHING = ()


class RepairedPackets:
    """Call `handle_zone` or `handle_lost` for every slot, in order; `give_up` at a break.

    settled: the stream's reassembly; it takes all packets. While no zone is lost, it alone reads.
    """

    def __init__(self, profile: LinkProfile, settled: PacketReassembly) -> None:
        symbols = Symbols(profile)
        self._is_repair, self._repair_pointers = symbols.is_repair, symbols.repair_pointers
        self._supervision = Pointers(profile).supervision
        self._decoder = RepairDecoder(profile)
        self._note = self._decoder.note
        self._settled = settled
        self._ahead = settled
        #: The next zone that it reads; -1: one before that was restored, so another has to read.
        self._ahead_at = -1
        #: Those that are not settled, from the oldest that may be restored on: pointer and zone;
        #: None: lost.
        self._zones: dict[int, Content | tuple[()] | None] = {}
        #: When they came, or were missed.
        self._came_ns: dict[int, int] = {}
        flows = settled.flows
        self._ordered, self._voice = (
            [flow.kind is FlowKind.RTP and flow.level is level for flow in flows]
            for level in (Level.VIDEO, Level.VOICE)
        )
        #: By flow: place of the newest packet, and its RTP sequence number; -1 without one.
        self._newest = [-1] * len(flows)
        self._sequences = [-1] * len(flows)
        #: Places of the packets that were handed on since a zone is lost.
        self._handed_on: set[int] = set()
        self._late = self._packets = self._torn = self._wait_max_ns = 0
        #: Zones are read again, because one before them was restored.
        self._anew = False
        settled.hand_on = self._hand_on

    def handle_zone(self, pointer: int, zone: bytes, count: int, now_ns: int) -> None:
        """The frame of the slot came."""
        if not self._zones:
            # This is all that repair costs in a slot of a link that loses nothing.
            self._note((pointer, zone))
            if pointer not in self._repair_pointers or not self._is_repair(pointer, zone):
                self._settled.handle_zone(pointer, zone, count, now_ns)
            return
        content: Content | tuple[()] = _NOTHING
        if pointer in self._repair_pointers and self._is_repair(pointer, zone):
            for slot, restored in self._decoder.handle_zone(count, pointer, zone):
                self._zones[slot] = restored or _NOTHING
                self._wait_max_ns = max(self._wait_max_ns, now_ns - self._came_ns[slot])
                self._anew, self._ahead_at = True, -1
        else:
            content = pointer, zone
            self._decoder.append(count, content)
            if pointer == self._supervision:
                # It is read at once, and once.
                self._settled.handle_zone(pointer, zone, count, now_ns)
                content = _NOTHING
        self._zones[count], self._came_ns[count] = content, now_ns
        if self._ahead_at == count and next(iter(self._zones)) in self._decoder.lost:
            # Nothing else is to be read.
            _read(self._ahead, content, count, now_ns)
            self._ahead_at += 1
        else:
            self._read_on(now_ns)

    def handle_lost(self, first: int, number: int, now_ns: int) -> None:
        """The frames of `number` slots from `first` on did not come."""
        if number >= WINDOW:
            self.give_up(now_ns)
            self._settled.drop_incomplete()
            return
        for count in range(first, first + number):
            self._decoder.handle_lost(count)
            self._zones[count], self._came_ns[count] = None, now_ns
        self._read_on(now_ns)

    def give_up(self, now_ns: int) -> None:
        """The stream breaks off: restore nothing more, and read all that came."""
        self._decoder.restart()
        self._read_on(now_ns, len(self._zones))
        self._newest = [-1] * len(self._newest)
        self._sequences = [-1] * len(self._sequences)

    def _read_on(self, now_ns: int, most: int = _MOST_ZONES) -> None:
        """Read up to the oldest zone that may still be restored, then what came behind it."""
        zones, lost, settled = self._zones, self._decoder.lost, self._settled
        read: list[int] = []
        for count, content in zones.items():
            if count in lost or len(read) == most:
                break
            before = settled.dropped.get("incomplete", 0)
            _read(settled, content, count, now_ns)
            if content is None:
                self._torn += settled.dropped.get("incomplete", 0) - before
            read.append(count)
        for count in read:
            del zones[count], self._came_ns[count]
        if not zones:
            self._ahead_at, self._anew = -1, False
            self._handed_on.clear()
            return
        oldest = next(iter(zones))
        if self._ahead_at < oldest:
            if oldest not in lost:
                return
            self._ahead, self._ahead_at = settled.fork(self._hand_on_ahead), oldest
        behind = oldest + len(zones)
        while self._ahead_at < behind and len(read) < most:
            _read(self._ahead, zones[self._ahead_at], self._ahead_at, now_ns)
            read.append(self._ahead_at)
            self._ahead_at += 1
        self._anew = self._anew and self._ahead_at < behind

    def _hand_on_ahead(self, place: int, number: int, packet: bytes, now_ns: int) -> None:
        last = self._sequences[number]
        if self._ordered[number] and last >= 0 and _sequence(packet) - last & 0xFFFF != 1:
            # One before it may be restored.
            return
        self._hand_on(place, number, packet, now_ns)

    def _hand_on(self, place: int, number: int, packet: bytes, now_ns: int) -> None:
        if self._zones:
            if place in self._handed_on:
                return
            self._handed_on.add(place)
            if self._is_late(place, number, now_ns):
                self._late += 1
                return
            self._packets += self._anew
        self._newest[number] = place
        if self._ordered[number]:
            self._sequences[number] = _sequence(packet)
        self._settled.take(place, number, packet, now_ns)

    def _is_late(self, place: int, number: int, now_ns: int) -> bool:
        """Whether a packet is of no use: newer ones of its flow came, or voice has been played."""
        if not self._voice[number]:
            return place < self._newest[number]
        came_ns = self._came_ns.get(place >> PLACE_SHIFT, now_ns)
        return now_ns - came_ns > VOICE_LATE_NS

    @property
    def losses(self) -> tuple[int, int]:
        """Zones lost, but for gaps as long as the window; and packets torn by zones given up."""
        decoder = self._decoder
        return decoder.restored + decoder.given_up + len(decoder.lost), self._torn

    def report(self) -> RepairMetrics:
        decoder = self._decoder
        return RepairMetrics(
            zones=decoder.restored,
            given_up=decoder.given_up,
            contradictions=decoder.contradictions,
            packets=self._packets,
            late=self._late,
            wait_max_ns=self._wait_max_ns,
        )


def _sequence(packet: bytes) -> int:
    """The sequence number of an RTP packet; of garbage any number."""
    return int.from_bytes(packet[2:4], "big")


def _read(
    packets: PacketReassembly, content: Content | tuple[()] | None, count: int, now_ns: int
) -> None:
    if content is None:
        packets.drop_incomplete()
    elif content:
        packets.handle_zone(*content, count, now_ns)
