"""Linear equations of lost symbols, solved as they come. No I/O, no clock."""

from collections.abc import Callable

from telepresence.link.repair.codes import inverse, multiply

#: Coefficients of lost slots, and the sum of their products with the slots' symbols.
Equation = tuple[dict[int, int], int]


class Unknowns:
    """The lost slots of one code, oldest first in `lost`; Gauss-Jordan elimination.

    scale: multiplies a symbol by a coefficient.
    """

    def __init__(self, scale: Callable[[int, int], int]) -> None:
        self._scale = scale
        self.lost: dict[int, None] = {}
        #: By the oldest lost slot in it. No other equation has that slot.
        self._equations: dict[int, Equation] = {}
        self.contradictions = 0

    def clear(self) -> None:
        self.lost.clear()
        self._equations.clear()

    def give_up(self, slot: int) -> None:
        """The oldest lost slot is not restored any more."""
        del self.lost[slot]
        self._equations.pop(slot, None)

    def know(self, slot: int) -> dict[int, int]:
        """The symbol of a lost slot is 0. Return what that restores, as `solve` does."""
        del self.lost[slot]
        equations = self._equations
        for unknown, _ in equations.values():
            unknown.pop(slot, None)
        # The rest of an equation that was led by this slot is a new one.
        rest = equations.pop(slot, None)
        restored = {} if rest is None else self.solve(*rest)
        return restored | self._take_solved()

    def solve(self, unknown: dict[int, int], value: int) -> dict[int, int]:
        """Take an equation; return the slots that it restores, and their symbols."""
        equations = self._equations
        for slot in [slot for slot in unknown if slot in equations]:
            unknown, value = self._subtract((unknown, value), unknown[slot], equations[slot])
        if not unknown:
            if value:
                # Some frame was wrong in spite of its FECF.
                self.contradictions += 1
                equations.clear()
            return {}
        pivot = min(unknown)
        factor = inverse(unknown[pivot])
        unknown = {slot: multiply(factor, old) for slot, old in unknown.items()}
        new = unknown, self._scaled(factor, value)
        for slot, equation in equations.items():
            if pivot in equation[0]:
                equations[slot] = self._subtract(equation, equation[0][pivot], new)
        equations[pivot] = new
        return self._take_solved()

    def _take_solved(self) -> dict[int, int]:
        solved = [slot for slot, (unknown, _) in self._equations.items() if len(unknown) == 1]
        for slot in solved:
            del self.lost[slot]
        return {slot: self._equations.pop(slot)[1] for slot in solved}

    def _subtract(self, equation: Equation, factor: int, other: Equation) -> Equation:
        unknown = dict(equation[0])
        for slot, coefficient in other[0].items():
            if left := unknown.get(slot, 0) ^ multiply(factor, coefficient):
                unknown[slot] = left
            else:
                del unknown[slot]
        return unknown, equation[1] ^ self._scaled(factor, other[1])

    def _scaled(self, factor: int, symbol: int) -> int:
        return symbol if factor == 1 else self._scale(factor, symbol)
