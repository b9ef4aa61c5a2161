"""The receiving end of the code: lost slots from repair zones. No I/O, no clock."""

from collections import deque

from telepresence.link.profile import LinkProfile
from telepresence.link.repair.codes import WINDOW, code_of
from telepresence.link.repair.symbols import ELEMENT_BITS, ELEMENTS, Content, Symbols
from telepresence.link.repair.unknowns import Unknowns

#: Slots, and their pointer and zone; None: packets waited.
Restored = list[tuple[int, Content | None]]

_ELEMENT = (1 << ELEMENT_BITS) - 1


class RepairDecoder:
    """Call `handle_zone` or `handle_lost` for every slot, in order; `restart` before a gap.

    lost: counts of the slots that may still be restored, oldest first. A slot is given up when it
    is older than the window. While `lost` is empty, `note` is enough for a slot with packets. While
    it is not, `append` is enough for a slot with packets, and for a lost one.
    """

    def __init__(self, profile: LinkProfile) -> None:
        self._symbols = Symbols(profile)
        self._code = code_of(profile)
        self.lost: dict[int, None] = {}
        #: First symbols, known of lost slots.
        self._known: dict[int, int] = {}
        #: First symbols, prepared, and second ones of the latest slots; of lost ones what is known.
        self._firsts: deque[int] = deque(maxlen=WINDOW)
        self._seconds: deque[int] = deque(maxlen=WINDOW)
        #: The slots behind them, whose symbols nobody needed yet; None: lost.
        self._contents: deque[Content | None] = deque(maxlen=WINDOW)
        self.note = self._contents.append
        self._first = Unknowns(self._code.bits)
        #: The second symbol is whole, or each element of it has equations of its own.
        parts = ELEMENTS if profile.pointer_in_vcid else 1
        self._second = [Unknowns(self._code.bits) for _ in range(parts)]
        #: Those in use: second symbols are asked for only behind a repair zone that has one.
        self._in_use = [self._first]
        self.restored = self.given_up = 0

    @property
    def contradictions(self) -> int:
        """Repair zones that did not agree with what came."""
        return sum(unknowns.contradictions for unknowns in (self._first, *self._second))

    def restart(self) -> None:
        """Nothing is known of the slots before the next one."""
        for known in (self._firsts, self._seconds, self._contents):
            known.clear()
        self.given_up += len(self.lost)
        for slot in list(self.lost):
            self._forget(slot)
        self._first.clear()

    def handle_lost(self, count: int) -> None:
        """The frame of this slot did not come."""
        self.append(count, None)
        self.lost[count] = None
        for unknowns in self._in_use:
            unknowns.lost[count] = None

    def handle_zone(self, count: int, pointer: int, zone: bytes) -> Restored:
        """The frame of this slot came.

        Return the slots that this restores, oldest first, as `Symbols.content` does.
        """
        restored: Restored = []
        if self.lost and self._symbols.is_repair(pointer, zone):
            self._convert()
            # An equation is of use only if its whole window is known or counted as lost.
            if len(self._firsts) == WINDOW:
                self._solve(count, pointer, zone)
                restored = self._take_restored(count - WINDOW)
        self.append(count, (pointer, zone))
        return restored

    def append(self, count: int, content: Content | None) -> None:
        """Take a slot with packets, as its pointer and zone; None for a lost slot."""
        self.note(content)
        while (oldest := next(iter(self.lost), count)) <= count - WINDOW:
            self.given_up += 1
            for unknowns in self._in_use:
                if oldest in unknowns.lost:
                    unknowns.give_up(oldest)
            self._forget(oldest)

    def _forget(self, slot: int) -> None:
        del self.lost[slot]
        self._known.pop(slot, None)
        if not self.lost:
            for unknowns in self._in_use[1:]:
                unknowns.clear()
            del self._in_use[1:]

    def _convert(self) -> None:
        symbols, prepare = self._symbols.symbols, self._code.prepare
        for content in self._contents:
            first, second = symbols(*content) if content else (0, 0)
            self._firsts.append(prepare(first))
            self._seconds.append(second)
        self._contents.clear()

    def _solve(self, count: int, pointer: int, zone: bytes) -> None:
        """Take the equations of the repair zone of the slot `count`, which comes next."""
        code, oldest = self._code, count - WINDOW
        first, second, left_out = self._symbols.parse(pointer, zone, count)
        first ^= code.sum(enumerate(self._firsts, oldest), count)
        for slot, symbol in self._first.solve(self._unknown(self._first, count), first).items():
            self._known[slot] = symbol
            self._firsts[slot - oldest] = code.prepare(symbol)
            if not self._symbols.is_plain(symbol):
                for part, unknowns in enumerate(self._in_use[1:]):
                    if slot in unknowns.lost:
                        self._note_seconds(part, unknowns.know(slot), oldest)
        if second is None:
            return
        if len(self._in_use) == 1:
            asked = [slot for slot in self.lost if self._may_be_plain(slot)]
            for unknowns in self._second:
                unknowns.lost = dict.fromkeys(asked)
            self._in_use += self._second
        # First symbols may have told some second ones.
        second ^= code.sum(enumerate(map(code.prepare, self._seconds), oldest), count)
        for part, unknowns in enumerate(self._second):
            if part != left_out:
                value = second if left_out is None else second >> part * ELEMENT_BITS & _ELEMENT
                self._note_seconds(
                    part, unknowns.solve(self._unknown(unknowns, count), value), oldest
                )

    def _may_be_plain(self, slot: int) -> bool:
        return slot not in self._known or self._symbols.is_plain(self._known[slot])

    def _note_seconds(self, part: int, solved: dict[int, int], oldest: int) -> None:
        for slot, value in solved.items():
            self._seconds[slot - oldest] |= value << part * ELEMENT_BITS

    def _unknown(self, unknowns: Unknowns, count: int) -> dict[int, int]:
        coefficient = self._code.coefficient
        return {slot: factor for slot in unknowns.lost if (factor := coefficient(count, slot))}

    def _take_restored(self, oldest: int) -> Restored:
        restored: Restored = []
        for slot in list(self.lost):
            # Without an equation for second symbols, only slots with a sample are restored.
            if (len(self._in_use) == 1 and self._may_be_plain(slot)) or any(
                slot in unknowns.lost for unknowns in self._in_use
            ):
                continue
            try:
                content = self._symbols.content(self._known[slot], self._seconds[slot - oldest])
                restored.append((slot, content))
                self.restored += 1
            except KeyError:
                self.given_up += 1
            self._forget(slot)
        return restored
