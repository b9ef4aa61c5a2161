"""The sending end: the repair zones of one direction. No I/O, no clock."""

from collections import deque

from telepresence.link.profile import LinkProfile
from telepresence.link.repair.codes import WINDOW, code_of
from telepresence.link.repair.symbols import Content, Symbols

#: Repair zones for each protected zone in idle slots, and the fewest after one.
_SHORT_CREDIT, _LONG_CREDIT = (1, 4), (2, 12)


class RepairEncoder:
    """Call `protect` for each slot whose zone is not idle, and `repair` for one that may be used.

    Idle slots carry as many repair zones as the zones before them earn, so that a link without
    traffic stays idle.
    """

    def __init__(self, profile: LinkProfile) -> None:
        self._symbols = Symbols(profile)
        self._code = code_of(profile)
        self._per_zone, self._least = _SHORT_CREDIT if profile.pointer_in_vcid else _LONG_CREDIT
        #: Protected slots, oldest first, with their first and second symbols.
        self._protected: deque[tuple[int, int, int]] = deque()
        self._credit = 0

    @property
    def least_position(self) -> int:
        """As of `Symbols`."""
        return self._symbols.least_position

    def protect(self, count: int, pointer: int, zone: bytes) -> None:
        """The slot `count` carries packets, or a supervision message."""
        self._protected.append((count, *self._symbols.symbols(pointer, zone)))
        self._forget(count)
        self._credit = min(max(self._credit + self._per_zone, self._least), WINDOW)

    def repair(self, count: int, *, plain: bool, reserved: bool = False) -> Content | None:
        """Pointer and zone of the slot's repair zone; None: it should be idle.

        plain: the frame has no sample. reserved: the slot is not idle, so no credit is needed.
        """
        self._forget(count)
        if not self._protected:
            self._credit = 0
        if not self._protected or not (reserved or self._credit):
            return None
        if not reserved:
            self._credit -= 1
        first = self._code.sum(((slot, first) for slot, first, _ in self._protected), count)
        second = None
        if plain:
            seconds = ((slot, second) for slot, _, second in self._protected if second)
            second = self._code.sum(seconds, count)
        return self._symbols.pack(first, second, count) if first or second else None

    def _forget(self, count: int) -> None:
        protected = self._protected
        while protected and protected[0][0] < count - WINDOW:
            protected.popleft()
