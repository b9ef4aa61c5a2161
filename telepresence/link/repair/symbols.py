"""The symbol of a slot, packet zone and first header pointer as one number; and the repair zone.

The *mark* says what the pointer says, in as few bits as the zone allows:

0: the zone is idle or a repair zone, and so is the whole symbol. 1 + p: a tag stands at p.
`goes_on`: no tag; the next pointer says whether the packet in flight ended with this zone.
`preempt`: as the pointer. `opaque`: not coded: zone 1 for a supervision message, zone 0 for a frame
without a sample.

A repair zone is a symbol, too: its mark is added to the first pointer code that is free. With the
pointer in the VCID and twelve octets of zone, codes 13 to 27 are free, and `idle` with a zone that
is not all zeros is the sixteenth.
"""

from telepresence.link.frame import Pointers
from telepresence.link.profile import LinkProfile

#: What a mended slot gives: first header pointer and zone; None: packets waited, or it is unknown.
Content = tuple[int, bytes]

#: The pointer of a repair zone without a sample, where the pointer is in the VCID.
_PLAIN_REPAIR = 25


class Symbols:
    """The symbols of one direction. bits: their length."""

    def __init__(self, profile: LinkProfile) -> None:
        self._pointers = pointers = Pointers(profile)
        self._size = size = profile.packet_zone_octets
        self._plain_size = profile.largest_zone_octets
        self._in_vcid = profile.pointer_in_vcid
        self._goes_on, self._preempt, self._opaque = size + 1, size + 2, size + 3
        self._mark_bits = mark_bits(profile)
        self._marks = 1 << self._mark_bits
        self.bits = 8 * size + self._mark_bits
        self._first_code = first_code(profile)
        self._zeros = bytes(size)
        self._mark_of = {pointers.idle: 0, pointers.no_start: self._goes_on, size: self._goes_on}
        self._mark_of[pointers.preempt] = self._preempt
        self._mark_of.update((position, position + 1) for position in range(size))
        self._pointer_of = {position + 1: position for position in range(size)}
        self._pointer_of |= {self._goes_on: pointers.no_start, self._preempt: pointers.preempt}

    def is_repair(self, pointer: int, zone: bytes) -> bool:
        """Whether it is a repair zone."""
        if self._in_vcid:
            if len(zone) != self._size:
                return pointer == _PLAIN_REPAIR
            if pointer == self._pointers.idle:
                return zone != self._zeros
            return self._size < pointer < self._pointers.supervision
        return self._first_code <= pointer < self._first_code + self._marks

    def symbol(self, pointer: int, zone: bytes) -> int:
        """The symbol of a slot."""
        if pointer == self._pointers.idle or self.is_repair(pointer, zone):
            return 0
        if pointer == self._pointers.supervision:
            return 1 << self._mark_bits | self._opaque
        mark = self._mark_of.get(pointer) if len(zone) == self._size else None
        if mark is None:
            return self._opaque
        return int.from_bytes(zone, "big") << self._mark_bits | mark

    def content(self, symbol: int) -> Content | None:
        """Pointer and zone of a mended symbol.

        None: it has no packets, or is not coded. Even an idle symbol has none, because packets may
        go on behind a repair zone.
        """
        mark, zone = symbol & self._marks - 1, symbol >> self._mark_bits
        pointer = self._pointer_of.get(mark)
        return None if pointer is None else (pointer, zone.to_bytes(self._size, "big"))

    def is_known(self, symbol: int) -> bool:
        """Whether a mended symbol says all of its slot: it is no frame without a sample."""
        return symbol & self._marks - 1 != self._opaque or symbol >> self._mark_bits == 1

    def pack(self, symbol: int, *, plain: bool) -> Content:
        """Return a repair zone. plain: its frame has no sample."""
        mark, number = symbol & self._marks - 1, symbol >> self._mark_bits
        zone = number.to_bytes(self._size, "big")
        if self._in_vcid:
            if plain:
                return _PLAIN_REPAIR, (zone + bytes((mark,))).ljust(self._plain_size, b"\0")
            if mark == self._marks - 1:
                return self._pointers.idle, zone
        elif plain:
            zone = zone.ljust(self._plain_size, b"\0")
        return self._first_code + mark, zone

    def parse(self, pointer: int, zone: bytes) -> int:
        """The symbol of a repair zone."""
        mark = pointer - self._first_code
        if self._in_vcid:
            if len(zone) != self._size:
                mark = zone[self._size] & self._marks - 1
            elif pointer == self._pointers.idle:
                mark = self._marks - 1
        return int.from_bytes(zone[: self._size], "big") << self._mark_bits | mark


def mark_bits(profile: LinkProfile) -> int:
    return (profile.packet_zone_octets + 3).bit_length()


def first_code(profile: LinkProfile) -> int:
    """The pointer of a repair zone with mark 0."""
    if profile.pointer_in_vcid:
        return profile.packet_zone_octets + 1
    return 1 << profile.largest_zone_octets.bit_length()


def has_codes(profile: LinkProfile) -> bool:
    """Whether enough pointer codes are free for repair zones.

    They are with twelve octets of zone where the pointer is in the VCID, else with up to 500.
    """
    spare = 1 if profile.pointer_in_vcid else 0
    end = first_code(profile) + (1 << mark_bits(profile)) - spare
    return end <= Pointers(profile).supervision
