"""The receiving end of the code: lost slots from repair zones. No I/O, no clock."""

from collections import deque

from telepresence.link.profile import LinkProfile
from telepresence.link.repair.codes import WINDOW, code_of, multiply
from telepresence.link.repair.symbols import ELEMENT_BITS, ELEMENTS, Content, Symbols
from telepresence.link.repair.unknowns import Unknowns

#: Slots, and their pointer and zone; None: packets waited.
Restored = list[tuple[int, Content | None]]

_ELEMENT = (1 << ELEMENT_BITS) - 1


class RepairDecoder:
    """Call `handle_zone` or `handle_lost` for every slot, in order; `restart` before a gap.

    lost: counts of the slots that may still be restored, oldest first. A slot is given up when it
    is older than the window.
    """

    def __init__(self, profile: LinkProfile) -> None:
        self._symbols = Symbols(profile)
        self._code = code = code_of(profile)
        self.lost: dict[int, None] = {}
        #: The latest slots: symbols, or pointer and zone while nobody needs them; None: lost.
        self._slots: deque[tuple[int, int] | Content | None] = deque(maxlen=WINDOW)
        self._first = Unknowns(code.scale)
        #: The second symbol is whole, or each element of it has equations of its own.
        scale, parts = (multiply, ELEMENTS) if profile.pointer_in_vcid else (code.scale, 1)
        self._second = [Unknowns(scale) for _ in range(parts)]
        #: Of lost slots: what is known of them so far.
        self._firsts: dict[int, int] = {}
        self._seconds: dict[int, dict[int, int]] = {}
        self.restored = self.given_up = 0

    @property
    def contradictions(self) -> int:
        """Repair zones that did not agree with what came."""
        return sum(unknowns.contradictions for unknowns in (self._first, *self._second))

    def restart(self) -> None:
        """Nothing is known of the slots before the next one."""
        self._slots.clear()
        for unknowns in (self._first, *self._second):
            unknowns.clear()
        self.given_up += len(self.lost)
        for known in (self.lost, self._firsts, self._seconds):
            known.clear()

    def handle_lost(self, count: int) -> None:
        """The frame of this slot did not come."""
        self._append(count, None)
        for lost in (self.lost, self._first.lost, *(each.lost for each in self._second)):
            lost[count] = None
        self._seconds[count] = {}

    def handle_zone(self, count: int, pointer: int, zone: bytes) -> Restored:
        """The frame of this slot came.

        Return the slots that this restores, oldest first, as `Symbols.content` does.
        """
        restored: Restored = []
        # An equation is of use only if its whole window is known or counted as lost.
        if self.lost and len(self._slots) == WINDOW and self._symbols.is_repair(pointer, zone):
            self._solve(count, pointer, zone)
            restored = self._take_restored(count)
        self._append(count, (pointer, zone))
        return restored

    def _append(self, count: int, slot: Content | None) -> None:
        self._slots.append(slot)
        while self.lost and (oldest := next(iter(self.lost))) <= count - WINDOW:
            self.given_up += 1
            self._forget(oldest)
            for unknowns in (self._first, *self._second):
                if oldest in unknowns.lost:
                    unknowns.give_up(oldest)

    def _forget(self, slot: int) -> None:
        del self.lost[slot], self._seconds[slot]
        self._firsts.pop(slot, None)

    def _solve(self, count: int, pointer: int, zone: bytes) -> None:
        """Take the equations of the repair zone of the slot `count`, which comes next."""
        code = self._code
        first, second, left_out = self._symbols.parse(pointer, zone, count)
        first ^= code.sum(self._known(count)[0], count)
        self._note_firsts(self._first.solve(self._unknown(self._first, count), first))
        if second is None or not any(unknowns.lost for unknowns in self._second):
            return
        # First symbols may have told some second ones.
        second ^= code.sum(self._known(count)[1], count)
        if left_out is None:
            whole = self._second[0]
            self._note_seconds(0, whole.solve(self._unknown(whole, count), second))
            return
        for element, unknowns in enumerate(self._second):
            if element != left_out:
                value = second >> element * ELEMENT_BITS & _ELEMENT
                self._note_seconds(element, unknowns.solve(self._unknown(unknowns, count), value))

    def _note_firsts(self, solved: dict[int, int]) -> None:
        for slot, symbol in solved.items():
            self._firsts[slot] = symbol
            if not self._symbols.is_plain(symbol):
                for part, unknowns in enumerate(self._second):
                    if slot in unknowns.lost:
                        self._note_seconds(part, {slot: 0, **unknowns.know(slot)})

    def _note_seconds(self, part: int, solved: dict[int, int]) -> None:
        for slot, value in solved.items():
            self._seconds[slot][part] = value

    def _unknown(self, unknowns: Unknowns, count: int) -> dict[int, int]:
        coefficient = self._code.coefficient
        return {slot: factor for slot in unknowns.lost if (factor := coefficient(count, slot))}

    def _known(self, count: int) -> tuple[list[tuple[int, int]], list[tuple[int, int]]]:
        """First and second symbols of the window, but for those that are 0."""
        slots, oldest = self._slots, count - len(self._slots)
        firsts, seconds = [], []
        for place, slot in enumerate(slots):
            count = oldest + place
            if slot is None:
                first, second = self._firsts.get(count, 0), self._second_of(count)
            elif isinstance(slot[1], int):
                first, second = slot
            else:
                first, second = slots[place] = self._symbols.symbols(*slot)
            if first:
                firsts.append((count, first))
            if second:
                seconds.append((count, second))
        return firsts, seconds

    def _second_of(self, slot: int) -> int:
        """What is known of the second symbol of a lost slot."""
        parts = self._seconds.get(slot, {}).items()
        return sum(value << part * ELEMENT_BITS for part, value in parts)

    def _take_restored(self, count: int) -> Restored:
        restored: Restored = []
        first_slot = count - len(self._slots)
        for slot in list(self.lost):
            first = self._firsts.get(slot)
            if first is None or len(self._seconds[slot]) < len(self._second):
                continue
            second = self._second_of(slot)
            self._slots[slot - first_slot] = first, second
            self._forget(slot)
            try:
                restored.append((slot, self._symbols.content(first, second)))
                self.restored += 1
            except KeyError:
                self.given_up += 1
        return restored
