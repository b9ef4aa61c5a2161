"""The two codes: coefficients of the slots that a repair zone covers, and sums of symbols.

`CauchyCode`, for symbols of 100 bits: GF(1024) with the polynomial x^10 + x^3 + 1. A symbol is ten
elements of ten bits, the highest bits first. The coefficient of slot s in the repair zone of slot
c is 1 / (512 + ((c xor s) and 511)). That is a Cauchy matrix, so n zones restore n lost slots.

`BinaryCode`, for long symbols: GF(2). Bit d of SHA-256 of the text "repair n" says whether the slot
c - d is covered, where n is c modulo 512. It needs one or two zones more than lost slots.
"""

from collections.abc import Iterable, Sequence
from functools import lru_cache
from hashlib import sha256
from typing import Protocol

from telepresence.link.profile import LinkProfile

#: Slots before a repair zone that it covers.
WINDOW = 100

#: Bits of an element, and of a symbol.
_BITS, _SYMBOL = 10, 100
_ORDER = (1 << _BITS) - 1
_POLYNOMIAL = 0x409
_DISTANCES = 512
#: The highest bit of each element of the longest number that `combine` takes.
_HIGHEST = sum(1 << _BITS * element + _BITS - 1 for element in range(2 * WINDOW))

_powers = [1]
while len(_powers) < _ORDER:
    _next = _powers[-1] << 1
    _powers.append(_next ^ _POLYNOMIAL if _next > _ORDER else _next)
_INVERSES = {element: _powers[-power] for power, element in enumerate(_powers)}


def inverse(a: int) -> int:
    """The element whose product with `a`, which is not 0, is 1."""
    return _INVERSES[a]


def combine(parts: Sequence[int]) -> int:
    """The sum of parts[i] times x^i, for numbers that consist of elements."""
    total = 0
    for part in reversed(parts):
        highest = total & _HIGHEST
        total = (total ^ highest) << 1 ^ (highest >> _BITS - 1) * (_POLYNOMIAL & _ORDER) ^ part
    return total


#: A factor that puts a copy of a symbol at each bit of a coefficient.
_COPIES = sum(1 << _SYMBOL * bit for bit in range(_BITS))
#: By (c xor s) and 511: the coefficient, and which of the copies its bits select.
_COEFFICIENTS = [inverse(_DISTANCES + distance) for distance in range(_DISTANCES)]
_SELECTED = [
    sum((1 << _SYMBOL) - 1 << _SYMBOL * bit for bit in range(_BITS) if coefficient >> bit & 1)
    for coefficient in _COEFFICIENTS
]


class Code(Protocol):
    """What encoder and decoder ask of a code. Slots are frame counts, not wrapped.

    bits: of an element.
    """

    bits: int

    def coefficient(self, count: int, slot: int) -> int:
        """The coefficient of a slot in the repair zone of the slot `count`; 0: not covered."""
        ...

    def prepare(self, symbol: int) -> int:
        """What `sum` takes for a symbol; 0 for 0."""
        ...

    def sum(self, prepared: Iterable[tuple[int, int]], count: int) -> int:
        """The repair symbol of the slot `count`, of slots before it and their symbols."""
        ...


class CauchyCode:
    """See the module."""

    bits = _BITS

    def coefficient(self, count: int, slot: int) -> int:
        return _COEFFICIENTS[(count ^ slot) & _DISTANCES - 1]

    def prepare(self, symbol: int) -> int:
        return symbol * _COPIES

    def sum(self, prepared: Iterable[tuple[int, int]], count: int) -> int:
        selected, distances, total = _SELECTED, _DISTANCES - 1, 0
        for slot, copies in prepared:
            if copies:
                total ^= copies & selected[(count ^ slot) & distances]
        return combine([total >> _SYMBOL * bit & (1 << _SYMBOL) - 1 for bit in range(_BITS)])


class BinaryCode:
    """See the module."""

    bits = 1

    def coefficient(self, count: int, slot: int) -> int:
        return _mask(count % _DISTANCES) >> count - slot & 1

    def prepare(self, symbol: int) -> int:
        return symbol

    def sum(self, prepared: Iterable[tuple[int, int]], count: int) -> int:
        mask, total = _mask(count % _DISTANCES), 0
        for slot, symbol in prepared:
            if symbol and mask >> count - slot & 1:
                total ^= symbol
        return total


@lru_cache(maxsize=_DISTANCES)
def _mask(number: int) -> int:
    return int.from_bytes(sha256(b"repair %d" % number).digest(), "big")


def code_of(profile: LinkProfile) -> Code:
    """The code of a direction: where the pointer is in the VCID, symbols have 100 bits."""
    return CauchyCode() if profile.pointer_in_vcid else BinaryCode()
