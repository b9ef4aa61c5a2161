"""Several frames of the radio link as one sample of a topic. A core.

| octets | what |
|---|---|
| 2 | number of frames |
| 8, 2 each | instant in ns, session clock; length |
| | the frames |

All numbers are little-endian.
"""

import struct
from collections.abc import Sequence

from kontur_av.errors import ProtocolError

_COUNT = struct.Struct("<H")
_HEAD = struct.Struct("<qH")


def pack_frames(frames: Sequence[tuple[int, bytes]]) -> bytes:
    """Return frames (instant in ns, octets) as octets. At most 65535 frames."""
    heads = [_HEAD.pack(at_ns, len(frame)) for at_ns, frame in frames]
    return b"".join([_COUNT.pack(len(frames)), *heads, *(frame for _, frame in frames)])


def unpack_frames(octets: bytes) -> list[tuple[int, bytes]]:
    """Return the frames of these octets; ProtocolError for octets of something else."""
    try:
        (count,) = _COUNT.unpack_from(octets)
        heads = list(_HEAD.iter_unpack(octets[_COUNT.size : _COUNT.size + count * _HEAD.size]))
    except struct.error:
        raise ProtocolError("no batch of frames") from None
    at = _COUNT.size + count * _HEAD.size
    if len(heads) != count or at + sum(length for _, length in heads) != len(octets):
        raise ProtocolError("a batch of frames of another length")
    found = []
    for at_ns, length in heads:
        found.append((at_ns, octets[at : at + length]))
        at += length
    return found
