"""The receiving end of the code: lost symbols from repair zones. No I/O, no clock."""

from collections import deque

from telepresence.link.profile import LinkProfile
from telepresence.link.repair.codes import WINDOW, code_of, inverse, multiply
from telepresence.link.repair.symbols import Content, Symbols

#: Coefficients of lost slots, by count, and the sum of their products with the slots' symbols.
_Equation = tuple[dict[int, int], int]


class RepairDecoder:
    """Call `handle_zone` or `handle_lost` for every slot, in order; `restart` before a gap.

    lost: counts of the slots that may still be restored, oldest first. A slot is given up when it
    is older than the window.
    """

    def __init__(self, profile: LinkProfile) -> None:
        self._symbols = Symbols(profile)
        self._code = code_of(profile)
        self.lost: dict[int, None] = {}
        #: The latest slots: symbol, or pointer and zone while nobody needs the symbol; None: lost.
        self._slots: deque[int | Content | None] = deque(maxlen=WINDOW)
        self._count = 0
        #: By the oldest lost slot in it. No other equation has that slot.
        self._equations: dict[int, _Equation] = {}
        self.restored = self.given_up = self.contradictions = 0

    def restart(self) -> None:
        """Nothing is known of the slots before the next one."""
        self._slots.clear()
        self._equations.clear()
        self.given_up += len(self.lost)
        self.lost.clear()

    def handle_lost(self, count: int) -> None:
        """The frame of this slot did not come."""
        self._append(count, None)
        self.lost[count] = None

    def handle_zone(self, count: int, pointer: int, zone: bytes) -> list[tuple[int, int]]:
        """The frame of this slot came. Return the slots that this restores, and their symbols."""
        restored: list[tuple[int, int]] = []
        # An equation is of use only if its whole window is known or counted as lost.
        if self.lost and len(self._slots) == WINDOW and self._symbols.is_repair(pointer, zone):
            restored = self._solve(count, self._symbols.parse(pointer, zone))
        self._append(count, (pointer, zone))
        return restored

    def _append(self, count: int, slot: Content | None) -> None:
        self._slots.append(slot)
        self._count = count
        lost = self.lost
        while lost and (oldest := next(iter(lost))) <= count - WINDOW:
            del lost[oldest]
            self._equations.pop(oldest, None)
            self.given_up += 1

    def _solve(self, count: int, value: int) -> list[tuple[int, int]]:
        """Take the equation of the repair zone of the slot `count`, which comes next."""
        coefficient, equations = self._code.coefficient, self._equations
        value ^= self._code.sum(self._known(count), count)
        unknown = {slot: factor for slot in self.lost if (factor := coefficient(count, slot))}
        for slot in [slot for slot in unknown if slot in equations]:
            unknown, value = self._subtract((unknown, value), unknown[slot], equations[slot])
        if not unknown:
            if value:
                # Some frame was wrong in spite of its FECF.
                self.contradictions += 1
                equations.clear()
            return []
        pivot = min(unknown)
        factor = inverse(unknown[pivot])
        new = (
            {slot: multiply(factor, old) for slot, old in unknown.items()},
            self._scaled(factor, value),
        )
        for slot, equation in equations.items():
            if pivot in equation[0]:
                equations[slot] = self._subtract(equation, equation[0][pivot], new)
        equations[pivot] = new
        return self._take_restored(count)

    def _known(self, count: int) -> list[tuple[int, int]]:
        """The slots of the window that are known, but for those whose symbol is 0."""
        slots, first, known = self._slots, count - len(self._slots), []
        for place, slot in enumerate(slots):
            if slot is not None:
                if not isinstance(slot, int):
                    slots[place] = slot = self._symbols.symbol(*slot)
                if slot:
                    known.append((first + place, slot))
        return known

    def _subtract(self, equation: _Equation, factor: int, other: _Equation) -> _Equation:
        unknown = dict(equation[0])
        for slot, coefficient in other[0].items():
            if left := unknown.get(slot, 0) ^ multiply(factor, coefficient):
                unknown[slot] = left
            else:
                del unknown[slot]
        return unknown, equation[1] ^ self._scaled(factor, other[1])

    def _scaled(self, factor: int, symbol: int) -> int:
        return symbol if factor == 1 else self._code.scale(factor, symbol)

    def _take_restored(self, count: int) -> list[tuple[int, int]]:
        first = count - len(self._slots)
        solved = [slot for slot, (unknown, _) in self._equations.items() if len(unknown) == 1]
        restored = []
        for slot in sorted(solved):
            _, symbol = self._equations.pop(slot)
            del self.lost[slot]
            self._slots[slot - first] = symbol
            restored.append((slot, symbol))
        self.restored += len(restored)
        return restored
