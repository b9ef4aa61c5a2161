"""The two codes: coefficients of the slots that a repair zone covers, and sums of symbols.

`CauchyCode`, for symbols of 100 bits: GF(1024) with the polynomial x^10 + x^3 + 1. A symbol is ten
elements of ten bits, the highest bits first. The coefficient of slot s in the repair zone of slot
c is 1 / (512 + ((c xor s) and 511)). That is a Cauchy matrix, so n zones restore n lost slots.

`BinaryCode`, for long symbols: GF(2). Bit d of SHA-256 of the text "repair n" says whether the slot
c - d is covered, where n is c modulo 512. It needs one or two zones more than lost slots.
"""

from collections.abc import Iterable
from functools import lru_cache
from hashlib import sha256
from typing import Protocol

import numpy as np

from telepresence.link.profile import LinkProfile

#: Slots before a repair zone that it covers.
WINDOW = 100

#: Bits of an element, elements of a symbol, and the bits that fill the last octet of a symbol.
_BITS, _ELEMENTS, _FILL = 10, 10, 4
_OCTETS = (_BITS * _ELEMENTS + _FILL) // 8
_ORDER = (1 << _BITS) - 1
_POLYNOMIAL = 0x409
_DISTANCES = 512
#: Stands for the logarithm of 0; its powers are 0.
_NONE = 2 * _ORDER

_powers = [1]
while len(_powers) < _ORDER:
    _next = _powers[-1] << 1
    _powers.append(_next ^ _POLYNOMIAL if _next > _ORDER else _next)
_EXP = _powers * 2
_LOG = [0] * (_ORDER + 1)
for _power, _element in enumerate(_powers):
    _LOG[_element] = _power
_EXP_ARRAY = np.zeros(2 * _NONE + 1, dtype=np.int16)
_EXP_ARRAY[: 2 * _ORDER] = _EXP
_LOG_ARRAY = np.array([_NONE, *_LOG[1:]], dtype=np.int16)
#: By (c xor s) and 511.
_COEFFICIENT_LOG = [(_ORDER - _LOG[_DISTANCES + d]) % _ORDER for d in range(_DISTANCES)]
_COEFFICIENT_LOGS = np.array(_COEFFICIENT_LOG, dtype=np.int16)
_WEIGHTS = (1 << np.arange(_BITS - 1, -1, -1)).astype(np.int16)


def multiply(a: int, b: int) -> int:
    """The product of two elements."""
    return _EXP[_LOG[a] + _LOG[b]] if a and b else 0


def inverse(a: int) -> int:
    """The element whose product with `a`, which is not 0, is 1."""
    return _EXP[_ORDER - _LOG[a]]


class Code(Protocol):
    """What encoder and decoder ask of a code. Slots are frame counts, not wrapped."""

    def coefficient(self, count: int, slot: int) -> int:
        """The coefficient of a slot in the repair zone of the slot `count`; 0: not covered."""
        ...

    def sum(self, symbols: Iterable[tuple[int, int]], count: int) -> int:
        """The repair symbol of the slot `count`, of slots before it and their symbols."""
        ...

    def scale(self, factor: int, symbol: int) -> int:
        """Each element of the symbol times the factor, which is not 0."""
        ...


class CauchyCode:
    """See the module."""

    def coefficient(self, count: int, slot: int) -> int:
        return _EXP[_COEFFICIENT_LOG[(count ^ slot) & _DISTANCES - 1]]

    def sum(self, symbols: Iterable[tuple[int, int]], count: int) -> int:
        distances, rows = [], []
        for slot, symbol in symbols:
            if symbol:
                distances.append((count ^ slot) & _DISTANCES - 1)
                rows.append((symbol << _FILL).to_bytes(_OCTETS, "big"))
        if not rows:
            return 0
        bits = np.unpackbits(np.frombuffer(b"".join(rows), dtype=np.uint8))
        bits = bits.reshape(len(rows), 8 * _OCTETS)[:, :-_FILL]
        logs = _LOG_ARRAY[bits.reshape(len(rows), _ELEMENTS, _BITS) @ _WEIGHTS]
        logs += _COEFFICIENT_LOGS[distances][:, None]
        total = 0
        for element in np.bitwise_xor.reduce(_EXP_ARRAY[logs], axis=0).tolist():
            total = total << _BITS | element
        return total

    def scale(self, factor: int, symbol: int) -> int:
        log, product = _LOG[factor], 0
        for shift in range(0, _BITS * _ELEMENTS, _BITS):
            element = symbol >> shift & _ORDER
            if element:
                product |= _EXP[log + _LOG[element]] << shift
        return product


class BinaryCode:
    """See the module."""

    def coefficient(self, count: int, slot: int) -> int:
        return _mask(count % _DISTANCES) >> count - slot & 1

    def sum(self, symbols: Iterable[tuple[int, int]], count: int) -> int:
        mask, total = _mask(count % _DISTANCES), 0
        for slot, symbol in symbols:
            if mask >> count - slot & 1:
                total ^= symbol
        return total

    def scale(self, factor: int, symbol: int) -> int:
        return symbol


@lru_cache(maxsize=_DISTANCES)
def _mask(number: int) -> int:
    return int.from_bytes(sha256(b"repair %d" % number).digest(), "big")


def code_of(profile: LinkProfile) -> Code:
    """The code of a direction: where the pointer is in the VCID, symbols have 100 bits."""
    return CauchyCode() if profile.pointer_in_vcid else BinaryCode()
