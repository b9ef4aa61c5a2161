"""What of a slot is coded: packet zone and first header pointer as two numbers; and repair zones.

The *first* symbol is the part of the zone that every frame has, and a *mark*, which says what the
pointer says in as few bits as the zone allows. The *second* is the rest of the zone of a frame
without a sample; it is 0 for all others.

A repair zone is a first symbol, too: its mark is added to the first pointer code that is free. In a
frame without a sample it has a second symbol as well. With the pointer in the VCID and twelve
octets of zone, codes 13 to 27 are free, and `idle` with a zone that is not all zeros is the
sixteenth; there the second symbol has a mark of its own, and one of its ten elements is left out.
docs/wire-formats.md has the bits.
"""

from hashlib import sha256
from typing import NamedTuple

from telepresence.link.frame import Pointers
from telepresence.link.profile import LinkProfile

#: First header pointer and packet zone.
Content = tuple[int, bytes]

#: With the pointer in the VCID: octets of zone, bits of a mark, of an element, of a symbol.
_SHORT_ZONE = 12
_SHORT_MARK_BITS = 4
ELEMENT_BITS, ELEMENTS = 10, 10
#: The zone of the first symbol of a supervision message there, unlike any zone of packets.
_SUPERVISION = int.from_bytes(sha256(b"supervision").digest()[:_SHORT_ZONE], "big")
#: The pointer of a repair zone without a sample there.
_PLAIN_REPAIR = 25


class RepairZone(NamedTuple):
    """The symbols of a repair zone. second: None in a frame with a sample.

    left_out: the element that the second symbol lacks; None: it is whole.
    """

    first: int
    second: int | None
    left_out: int | None


class Symbols:
    """The symbols of one direction."""

    def __init__(self, profile: LinkProfile) -> None:
        self._pointers = pointers = Pointers(profile)
        self._size = size = profile.packet_zone_octets
        self._plain = plain = profile.largest_zone_octets
        self._short = profile.pointer_in_vcid
        self._mark_bits = _mark_bits(profile)
        self._marks = 1 << self._mark_bits
        self._first_code = _first_code(profile)
        self._zeros = bytes(size)
        #: Pointers that repair zones have; only `is_repair` tells whether a zone with one is one.
        behind = pointers.supervision if self._short else self._first_code + self._marks
        self.repair_pointers = {*range(self._first_code, behind)}
        if self._short:
            self.repair_pointers.add(pointers.idle)
        self._supervision = size + 3
        mark_of = {position: position + 1 for position in range(size)}
        mark_of |= {size: size + 1, pointers.no_start: size + 1, pointers.preempt: size + 2}
        self._mark_of = mark_of
        #: Marks of frames without a sample: of the second symbol if it is short, else of the first.
        if self._short:
            plain_of = {0: 0} | {position: position - size + 1 for position in range(size, plain)}
            plain_of |= {plain: size + 1, pointers.no_start: size + 1, pointers.preempt: size + 2}
        else:
            base = size + 4
            plain_of = {position: base + position for position in range(plain)}
            plain_of |= {plain: base + plain, pointers.no_start: base + plain}
            plain_of[pointers.preempt] = base + plain + 1
        #: Whether frames without a sample are coded.
        self._codes_plain = not self._short or plain == 2 * size
        self._plain_of = plain_of if self._codes_plain else {}
        # Of the two pointers of one mark, `no_start` is later.
        self._pointer_of = {mark: pointer for pointer, mark in mark_of.items()}
        self._plain_pointer_of = {mark: pointer for pointer, mark in self._plain_of.items()}

    @property
    def least_position(self) -> int:
        """In a frame without a sample a packet must not end in the zone before this position."""
        return self._size if self._short and self._codes_plain else 0

    def is_repair(self, pointer: int, zone: bytes) -> bool:
        """Whether it is a repair zone."""
        if self._short:
            if len(zone) != self._size:
                return pointer == _PLAIN_REPAIR
            if pointer == self._pointers.idle:
                return zone != self._zeros
        return pointer in self.repair_pointers

    def symbols(self, pointer: int, zone: bytes) -> tuple[int, int]:
        """First and second symbol of a slot; an idle slot and a repair zone have 0.

        What no sender with repair sends counts as a supervision message.
        """
        size, bits = self._size, self._mark_bits
        if len(zone) == size:
            if (mark := self._mark_of.get(pointer)) is not None:
                return int.from_bytes(zone, "big") << bits | mark, 0
        elif (mark := self._plain_of.get(pointer)) is not None:
            number, second = (int.from_bytes(part, "big") for part in (zone[:size], zone[size:]))
            if self._short:
                return number << bits | self._supervision, second << bits | mark
            return number << bits | mark, second
        if pointer == self._pointers.idle or self.is_repair(pointer, zone):
            return 0, 0
        return (_SUPERVISION if self._short else 0) << bits | self._supervision, 0

    def is_plain(self, first: int) -> bool:
        """Whether a first symbol is of packets in a frame without a sample."""
        mark = first & self._marks - 1
        if self._short:
            return mark == self._supervision and first >> self._mark_bits != _SUPERVISION
        return mark > self._supervision

    def content(self, first: int, second: int) -> Content | None:
        """Pointer and zone of a restored slot; None: packets waited.

        They also wait in an idle slot, because they may go on behind a repair zone. Raises KeyError
        if the slot was not coded.
        """
        mark, number = first & self._marks - 1, first >> self._mark_bits
        if not self.is_plain(first):
            if mark in (0, self._supervision):
                return None
            return self._pointer_of[mark], number.to_bytes(self._size, "big")
        if self._short:
            second, mark = second >> self._mark_bits, second & self._marks - 1
        rest = second.to_bytes(self._plain - self._size, "big")
        return self._plain_pointer_of[mark], number.to_bytes(self._size, "big") + rest

    def pack(self, first: int, second: int | None, count: int) -> Content:
        """Return a repair zone of the slot `count`. second: None in a frame with a sample."""
        mark, number = first & self._marks - 1, first >> self._mark_bits
        zone = number.to_bytes(self._size, "big")
        if not self._short:
            rest = b"" if second is None else second.to_bytes(self._plain - self._size, "big")
            return self._first_code + mark, zone + rest
        if second is None:
            last = mark == self._marks - 1
            return self._pointers.idle if last else self._first_code + mark, zone
        at = count % ELEMENTS * ELEMENT_BITS
        low = second & (1 << at) - 1
        kept = (second >> at + ELEMENT_BITS << at | low) << self._mark_bits | mark
        return _PLAIN_REPAIR, zone + kept.to_bytes(self._plain - self._size, "big")

    def parse(self, pointer: int, zone: bytes, count: int) -> RepairZone:
        """The symbols of a repair zone."""
        size, plain = self._size, len(zone) != self._size
        number = int.from_bytes(zone[:size], "big") << self._mark_bits
        second = int.from_bytes(zone[size:], "big")
        if not self._short:
            return RepairZone(number | pointer - self._first_code, second if plain else None, None)
        if not plain:
            last = pointer == self._pointers.idle
            mark = self._marks - 1 if last else pointer - self._first_code
            return RepairZone(number | mark, None, None)
        element = count % ELEMENTS
        at = element * ELEMENT_BITS
        kept = second >> self._mark_bits
        whole = kept >> at << at + ELEMENT_BITS | kept & (1 << at) - 1
        return RepairZone(number | second & self._marks - 1, whole, element)


def _mark_bits(profile: LinkProfile) -> int:
    if profile.pointer_in_vcid:
        return _SHORT_MARK_BITS
    return (profile.packet_zone_octets + profile.largest_zone_octets + 5).bit_length()


def _first_code(profile: LinkProfile) -> int:
    """The pointer of a repair zone with mark 0."""
    if profile.pointer_in_vcid:
        return profile.packet_zone_octets + 1
    return 1 << profile.largest_zone_octets.bit_length()


def has_codes(profile: LinkProfile) -> bool:
    """Whether enough pointer codes are free for repair zones.

    They are with twelve octets of zone where the pointer is in the VCID, else with up to 499.
    """
    if profile.pointer_in_vcid:
        return profile.packet_zone_octets == _SHORT_ZONE
    return _first_code(profile) + (1 << _mark_bits(profile)) <= Pointers(profile).supervision
