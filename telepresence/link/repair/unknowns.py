"""Linear equations of lost symbols, solved as they come. No I/O, no clock."""

from telepresence.link.repair.codes import combine, inverse

#: Places of coefficients. Lost slots of one time are less than so many slots apart.
_PLACES = 128
#: By element: its bits.
_BITS_OF = [tuple(bit for bit in range(10) if element >> bit & 1) for element in range(1024)]


class Unknowns:
    """The lost slots of one code, oldest first in `lost`; Gauss-Jordan elimination.

    An equation is one number, so that a row operation is a few operations on it: the coefficient of
    each lost slot in the slot's place, and above them the sum of the products with the symbols.

    bits: of an element.
    """

    def __init__(self, bits: int) -> None:
        self._bits = bits
        self._element = (1 << bits) - 1
        self._value_at = bits * _PLACES
        self._coefficients = (1 << self._value_at) - 1
        self.lost: dict[int, None] = {}
        #: By the oldest lost slot in it, with the coefficient 1. No other equation has that slot.
        self._equations: dict[int, int] = {}
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
        # The rest of an equation that was led by this slot is a new one.
        rest = equations.pop(slot, None)
        for other, equation in equations.items():
            equations[other] = equation ^ (self._of(equation, slot) << self._place(slot))
        restored = {} if rest is None else self._take(rest ^ (1 << self._place(slot)))
        return restored | self._take_solved()

    def solve(self, unknown: dict[int, int], value: int) -> dict[int, int]:
        """Take an equation; return the slots that it restores, and their symbols.

        unknown: coefficients of lost slots. value: the sum of the products with their symbols.
        """
        equation = value << self._value_at
        for slot, coefficient in unknown.items():
            equation |= coefficient << self._place(slot)
        return self._take(equation)

    def _take(self, equation: int) -> dict[int, int]:
        equations, parts = self._equations, [0] * self._bits
        for slot, other in equations.items():
            for bit in _BITS_OF[self._of(equation, slot)]:
                parts[bit] ^= other
        if equations:
            equation ^= combine(parts)
        oldest = next((slot for slot in self.lost if self._of(equation, slot)), None)
        if oldest is None:
            if equation:
                # Some frame was wrong in spite of its FECF.
                self.contradictions += 1
                equations.clear()
            return {}
        if (factor := self._of(equation, oldest)) != 1:
            bits = _BITS_OF[inverse(factor)]
            equation = combine([equation * (bit in bits) for bit in range(self._bits)])
        multiples = [equation]
        for slot, other in equations.items():
            if factor := self._of(other, oldest):
                while len(multiples) < self._bits:
                    multiples.append(combine((0, multiples[-1])))
                for bit in _BITS_OF[factor]:
                    other ^= multiples[bit]
                equations[slot] = other
        equations[oldest] = equation
        return self._take_solved()

    def _take_solved(self) -> dict[int, int]:
        solved = [
            slot
            for slot, equation in self._equations.items()
            if equation & self._coefficients == 1 << self._place(slot)
        ]
        for slot in solved:
            del self.lost[slot]
        return {slot: self._equations.pop(slot) >> self._value_at for slot in solved}

    def _place(self, slot: int) -> int:
        return slot % _PLACES * self._bits

    def _of(self, equation: int, slot: int) -> int:
        """The coefficient of a slot in an equation."""
        return (equation & self._coefficients) >> self._place(slot) & self._element
