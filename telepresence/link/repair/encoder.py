"""The sending end: the repair zones of one direction. No I/O, no clock."""

from collections import deque
from enum import IntEnum

from telepresence.link.profile import LinkProfile
from telepresence.link.repair.codes import WINDOW, code_of
from telepresence.link.repair.symbols import Content, Symbols


class Idle(IntEnum):
    """How much of the idle slots carries repair.

    FEW restore the first losses, before the other end has reported any.
    """

    NONE = 0
    FEW = 1
    MANY = 2


#: Repair zones in idle slots for each protected zone, and the fewest behind one; by `Idle`.
_SHORT_CREDITS = (0, 0), (0, 2), (1, 4)
_LONG_CREDITS = (0, 0), (0, 2), (1, 6)


class RepairEncoder:
    """Call `protect` for each slot whose zone is not idle, and `repair` for one that may be used.

    Idle slots carry as many repair zones as the zones before them earn, so that a link without
    traffic stays idle.

    least_position: as of `Symbols`.
    new: slots protected since a repair zone was last made, with pointer and zone.
    credit: repair zones that the slots before them have earned. Without both, `repair` returns None
        for an idle slot.
    """

    def __init__(self, profile: LinkProfile) -> None:
        self._symbols = Symbols(profile)
        self.least_position = self._symbols.least_position
        self._code = code_of(profile)
        self._credits = _SHORT_CREDITS if profile.pointer_in_vcid else _LONG_CREDITS
        #: Protected slots, oldest first, with their symbols, prepared: first ones, second ones.
        self._firsts: deque[tuple[int, int]] = deque(maxlen=WINDOW)
        self._seconds: deque[tuple[int, int]] = deque(maxlen=WINDOW)
        self.new: deque[tuple[int, int, bytes]] = deque(maxlen=WINDOW)
        self.credit = 0
        self.set_idle(Idle.MANY)

    def set_idle(self, idle: Idle) -> None:
        """How much of the idle slots carries repair from now on."""
        self._per_zone, self._least = self._credits[idle]

    def protect(self, count: int, pointer: int, zone: bytes) -> None:
        """The slot `count` carries packets, or a supervision message."""
        self.new.append((count, pointer, zone))

    def repair(self, count: int, *, plain: bool, reserved: bool = False) -> Content | None:
        """Pointer and zone of the slot's repair zone; None: it should be idle.

        plain: the frame has no sample. reserved: the slot is not idle, so no credit is needed.
        """
        if new := len(self.new):
            credit = max(self.credit, self._least - self._per_zone) + new * self._per_zone
            self.credit = min(credit, WINDOW)
        if not reserved:
            if not self.credit:
                return None
            self.credit -= 1
        code = self._code
        for slot, pointer, zone in self.new:
            first, second = self._symbols.symbols(pointer, zone)
            self._firsts.append((slot, code.prepare(first)))
            if second:
                self._seconds.append((slot, code.prepare(second)))
        self.new.clear()
        for protected in (self._firsts, self._seconds):
            while protected and protected[0][0] < count - WINDOW:
                protected.popleft()
        first = code.sum(self._firsts, count)
        rest = code.sum(self._seconds, count) if plain else None
        return self._symbols.pack(first, rest, count) if first or rest else None
