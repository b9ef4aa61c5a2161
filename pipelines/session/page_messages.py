"""The binary messages between a seat's server and its pages, all little-endian.

| octet 0 | message | header, in octets |
|---|---|---|
| 1 | access unit | stream 1, flags 1, 0 1, sequence 4, capture (µs) 8 |
| 2 | sound | as an access unit; then int16 mono at 48 kHz |
| 3 | haptics | end 1, rows 2, 0 4; then rows: instant (µs) 8, 4 for each field and axis, flags 4 |
| 4 | preview | preview 1, width 2, height 2, 0 2, capture (µs) 8; then I420 |
| 5 | pong | 0 7, page's instant (ms) 8, the session's instant (µs) 8 |
| 0x81 | ping | 0 7, page's instant (ms) 8 |
| 0x82 | hand | flags 1, buttons 2, sequence 4, x 4, y 4, capture of the painted picture (µs) 8 |
| 0x83 | own picture | input 1, width 2, height 2, 0 2, capture (page's ms) 8; then I420 |
| 0x84 | own sound | input 1, samples 2, sequence 4, first sample (page's ms) 8; then int16 |

The last four come from pages. Their length is checked before anything else is read.
"""

import struct
from collections.abc import Mapping
from math import isfinite
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kontur_av.clock import NS_PER_US
from kontur_av.errors import ProtocolError
from kontur_av.media import BLOCK_SAMPLES, I420
from telepresence.haptics.axes import MOST_MORE_AXES
from telepresence.haptics.device.page import NO_PICTURE, PageInput

UNIT, SOUND, HAPTIC, PREVIEW, PONG = 1, 2, 3, 4, 5
PING, HAND, OWN_PICTURE, OWN_SOUND = 0x81, 0x82, 0x83, 0x84

#: Flags of an access unit. A replayed one is decoded, but not drawn.
KEY, DAMAGED, REPLAYED = 1, 2, 4
#: The flag of a block of sound that was made up.
CONCEALED = 1
#: In place of a capture time that is not known.
UNKNOWN_US = -1

_UNIT = struct.Struct("<BBBxIq")
_HAPTIC = struct.Struct("<BBHI")
_PREVIEW = struct.Struct("<BBHHxxq")
_PONG = struct.Struct("<B7xdq")
_PING = struct.Struct("<B7xd")
_HAND = struct.Struct("<BBHIffd")
_OWN_PICTURE = struct.Struct("<BBHHxxd")
_OWN_SOUND = struct.Struct("<BBHId")
_DEAD_MAN = 1

#: The longest message on the socket of a seat.
MOST_SEAT_OCTETS = 4096


class Ping(NamedTuple):
    """page_ms: the page's clock when it was sent."""

    page_ms: float


class OwnPicture(NamedTuple):
    """A picture of the page's own camera, in the size of the input. page_ms: of its capture."""

    input: int
    page_ms: float
    data: memoryview


class OwnSound(NamedTuple):
    """20 ms of the page's own microphone. page_ms: of the first sample. data: int16."""

    input: int
    sequence: int
    page_ms: float
    data: memoryview


def pack_unit(stream: int, flags: int, sequence: int, capture_us: int, data: bytes) -> bytes:
    """Return an access unit (Annex B) as a message. capture_us: `UNKNOWN_US` if not known."""
    return _UNIT.pack(UNIT, stream, flags, sequence & 0xFFFF_FFFF, capture_us) + data


def pack_sound(
    stream: int, sequence: int, capture_us: int, samples: bytes, *, concealed: bool
) -> bytes:
    """Return a block of sound as a message. samples: int16."""
    flags = CONCEALED if concealed else 0
    return _UNIT.pack(SOUND, stream, flags, sequence & 0xFFFF_FFFF, capture_us) + samples


def pack_haptic(end: int, rows: NDArray[np.void]) -> bytes:
    """Return rows of `pipelines.hand.haptic_trace` as a message.

    end: 0 for the joystick, 1 for the robot.
    """
    kind = rows.dtype
    plain = [(name, "<f4") for name in kind.names or () if kind[name] == np.float32]
    plain.append(("flags", "<u4"))
    out = np.empty(len(rows), [("time_us", "<f8"), *plain])
    # JavaScript has no 64-bit integers.
    out["time_us"] = rows["time_ns"] / NS_PER_US
    for name, _ in plain:
        out[name] = rows[name]
    return _HAPTIC.pack(HAPTIC, end, len(rows), 0) + out.tobytes()


def pack_preview(preview: int, capture_us: int, picture: I420) -> bytes:
    height, width = picture.shape[0] * 2 // 3, picture.shape[1]
    return _PREVIEW.pack(PREVIEW, preview, width, height, capture_us) + picture.tobytes()


def pack_pong(page_ms: float, now_us: int) -> bytes:
    """Return the answer to a ping. now_us: the session's clock."""
    return _PONG.pack(PONG, page_ms, now_us)


def parse_seat_message(data: bytes, now_ns: int) -> Ping | PageInput:
    """Return what came on the socket of a seat; ProtocolError for anything else.

    now_ns: when it came.
    """
    kind = data[0] if data else 0
    if kind == PING:
        return _ping(data)
    if kind != HAND:
        raise ProtocolError(f"a message of unknown type {kind}")
    axes, rest = divmod(len(data) - _HAND.size, 4)
    if rest or not 0 <= axes <= MOST_MORE_AXES:
        raise ProtocolError(f"a hand of {len(data)} octets")
    _, flags, buttons, sequence, x, y, picture_us = _HAND.unpack_from(data)
    more = struct.unpack_from(f"<{axes}f", data, _HAND.size)
    # A NaN fails the comparisons, too.
    if not (all(-1.0 <= share <= 1.0 for share in (x, y, *more)) and isfinite(picture_us)):
        raise ProtocolError("a hand out of its range")
    if flags & ~_DEAD_MAN:
        raise ProtocolError(f"a hand with unknown flags {flags}")
    picture_ns = round(picture_us) * NS_PER_US if picture_us >= 0.0 else NO_PICTURE
    return PageInput(bool(flags & _DEAD_MAN), x, y, buttons, sequence, now_ns, picture_ns, more)


def parse_media_message(
    data: bytes, sizes: Mapping[int, tuple[int, int] | None]
) -> Ping | OwnPicture | OwnSound:
    """Return what came on the socket of a camera or microphone; ProtocolError for anything else.

    sizes: width and height of the pictures of each input, by its index; None: an input of sound.
    """
    kind = data[0] if data else 0
    if kind == PING:
        return _ping(data)
    if kind == OWN_PICTURE:
        return _own_picture(data, sizes)
    if kind == OWN_SOUND:
        return _own_sound(data, sizes)
    raise ProtocolError(f"a message of unknown type {kind}")


def most_media_octets(sizes: Mapping[int, tuple[int, int] | None]) -> int:
    """Return the length of the longest message that `parse_media_message` takes."""
    pictures = [_picture_octets(size) for size in sizes.values() if size is not None]
    return max(_OWN_SOUND.size + 2 * BLOCK_SAMPLES, MOST_SEAT_OCTETS, *pictures)


def _ping(data: bytes) -> Ping:
    if len(data) != _PING.size:
        raise ProtocolError(f"a ping of {len(data)} octets")
    page_ms = _PING.unpack(data)[1]
    if not isfinite(page_ms):
        raise ProtocolError("a ping without an instant")
    return Ping(page_ms)


def _picture_octets(size: tuple[int, int]) -> int:
    return _OWN_PICTURE.size + size[0] * size[1] * 3 // 2


def _own_picture(data: bytes, sizes: Mapping[int, tuple[int, int] | None]) -> OwnPicture:
    if len(data) < _OWN_PICTURE.size:
        raise ProtocolError(f"a picture of {len(data)} octets")
    _, index, width, height, page_ms = _OWN_PICTURE.unpack_from(data)
    size = sizes.get(index)
    if size is None:
        raise ProtocolError(f"a picture for input {index}")
    if (width, height) != size or len(data) != _picture_octets(size):
        raise ProtocolError(f"a picture of {width}x{height} in {len(data)} octets")
    if not isfinite(page_ms):
        raise ProtocolError("a picture without an instant")
    return OwnPicture(index, page_ms, memoryview(data)[_OWN_PICTURE.size :])


def _own_sound(data: bytes, sizes: Mapping[int, tuple[int, int] | None]) -> OwnSound:
    if len(data) != _OWN_SOUND.size + 2 * BLOCK_SAMPLES:
        raise ProtocolError(f"sound of {len(data)} octets")
    _, index, samples, sequence, page_ms = _OWN_SOUND.unpack_from(data)
    if samples != BLOCK_SAMPLES:
        raise ProtocolError(f"sound of {samples} samples")
    if index not in sizes or sizes[index] is not None:
        raise ProtocolError(f"sound for input {index}")
    if not isfinite(page_ms):
        raise ProtocolError("sound without an instant")
    return OwnSound(index, sequence, page_ms, memoryview(data)[_OWN_SOUND.size :])
