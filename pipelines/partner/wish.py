"""What the process with the partners tells the one that codes for them, as octets. A core."""

import struct
from typing import NamedTuple, Self

_FORMAT = struct.Struct("=qq")
WISH_OCTETS = _FORMAT.size


class Wish(NamedTuple):
    """How to code the picture for partners.

    bps: its rate; 0: nobody watches. keys: grows with each key picture that is wanted.
    """

    bps: int
    keys: int

    def pack(self) -> bytes:
        """Return it as `WISH_OCTETS` octets."""
        return _FORMAT.pack(*self)

    @classmethod
    def unpack(cls, octets: bytes) -> Self:
        """Return the wish that `pack` packed."""
        return cls(*_FORMAT.unpack(octets))
