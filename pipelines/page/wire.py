"""The messages between a page and its server, octet by octet. A core.

Binary messages are little-endian; the first octet is the type. `docs/seats-architecture.md` has the
table of their fields.
"""

import math
import struct
from typing import Literal, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from kontur_av.clock import NS_PER_US
from kontur_av.errors import ProtocolError
from kontur_av.media import BLOCK_SAMPLES

UNIT, SOUND, HAPTIC, PREVIEW, PONG = 1, 2, 3, 4, 5
PING, HAND, PICTURE, OWN_SOUND = 0x81, 0x82, 0x83, 0x84

KEY, DAMAGED, REPLAYED = 1, 2, 4
CONCEALED = 1
_UNKNOWN_US = -1

_MEDIA = struct.Struct("<BBBxIq")
_HAPTIC = struct.Struct("<BBHI")
_PREVIEW = struct.Struct("<BBHHHq")
_PONG = struct.Struct("<B7xdq")
_PING = struct.Struct("<B7xd")
_HAND = struct.Struct("<BBHIffd")
_OWN = struct.Struct("<BBHHHd")
_OWN_SOUND = struct.Struct("<BBHId")

#: The longest text and the longest binary message that a seat's page sends.
MOST_TEXT_OCTETS = 4096
HEADER_OCTETS = _OWN.size
OWN_SOUND_OCTETS = _OWN_SOUND.size + 2 * BLOCK_SAMPLES

#: A row of haptics on the wire.
_ROW = np.dtype(
    [
        ("time_us", "<f8"),
        ("x_m", "<f4"),
        ("y_m", "<f4"),
        ("fx_n", "<f4"),
        ("fy_n", "<f4"),
        ("energy_uj", "<f4"),
        ("flags", "<u4"),
    ]
)


class Ping(NamedTuple):
    """A page asks for the server's time. page_ms: its own, which is echoed."""

    page_ms: float


class HandMoved(NamedTuple):
    """What a page's hand does. x, y: -1 to 1 of the half workspace, y up. buttons: a bit each."""

    dead_man: bool
    x: float
    y: float
    buttons: int
    sequence: int
    page_ms: float


class OwnPicture(NamedTuple):
    """A picture of a page's own camera. i420: width * height * 3 / 2 octets."""

    input: int
    width: int
    height: int
    page_ms: float
    i420: memoryview


class OwnSound(NamedTuple):
    """20 ms of a page's own microphone. page_ms: of the first sample. samples: int16, mono."""

    input: int
    sequence: int
    page_ms: float
    samples: memoryview


class Request(msgspec.Struct, frozen=True, kw_only=True):
    """What a page asks for in words. request: its number, which the answer repeats."""

    request: int
    do: Literal["select", "joystick", "hand", "input", "session"]
    camera: str = ""
    event: str = ""
    action: str = ""
    name: str = ""
    on: bool = False


class Answer(msgspec.Struct, frozen=True, kw_only=True, tag_field="kind", tag="answer"):
    """The answer to a request. error: why it was not done, in one line."""

    request: int
    ok: bool
    error: str = ""
    round_trip_ms: float | None = None


_REQUESTS = msgspec.json.Decoder(Request)


def pack_unit(
    stream: int, data: bytes, *, flags: int, sequence: int, capture_ns: int | None
) -> bytes:
    """Return an access unit (Annex B) of the seat's stream `stream`."""
    return _MEDIA.pack(UNIT, stream, flags, sequence & 0xFFFFFFFF, _us(capture_ns)) + data


def pack_sound(
    stream: int, samples: bytes, *, flags: int, sequence: int, capture_ns: int | None
) -> bytes:
    """Return a block of sound: int16, mono, 48 kHz."""
    return _MEDIA.pack(SOUND, stream, flags, sequence & 0xFFFFFFFF, _us(capture_ns)) + samples


def pack_haptics(end: int, rows: NDArray[np.void]) -> bytes:
    """Return rows of `pipelines.cores.haptic_trace.ROW`. end: 0 for the joystick, 1 the robot."""
    told = np.empty(len(rows), _ROW)
    told["time_us"] = rows["time_ns"] / NS_PER_US
    for name in ("x_m", "y_m", "fx_n", "fy_n", "energy_uj", "flags"):
        told[name] = rows[name]
    return _HAPTIC.pack(HAPTIC, end, len(rows), 0) + told.tobytes()


def pack_preview(preview: int, width: int, height: int, capture_ns: int, i420: bytes) -> bytes:
    """Return a small picture of an input."""
    return _PREVIEW.pack(PREVIEW, preview, width, height, 0, _us(capture_ns)) + i420


def pack_pong(ping: Ping, now_ns: int) -> bytes:
    """Return the answer to a ping."""
    return _PONG.pack(PONG, ping.page_ms, now_ns // NS_PER_US)


def parse_binary(data: bytes) -> Ping | HandMoved | OwnPicture | OwnSound:
    """Return a page's binary message. ProtocolError for anything else."""
    kind = data[0] if data else 0
    if kind == PING:
        _check_size(_PING, data)
        return Ping(_finite(_PING.unpack(data)[1]))
    if kind == HAND:
        _check_size(_HAND, data)
        _, flags, buttons, sequence, x, y, page_ms = _HAND.unpack(data)
        if flags & ~1:
            raise ProtocolError(f"flags {flags} of a hand")
        if not (-1.0 <= x <= 1.0 and -1.0 <= y <= 1.0):  # NaN, too
            raise ProtocolError("a hand beyond its workspace")
        return HandMoved(bool(flags), x, y, buttons, sequence, _finite(page_ms))
    if kind == PICTURE:
        return _own_picture(data)
    if kind == OWN_SOUND:
        if len(data) != OWN_SOUND_OCTETS:
            raise ProtocolError(f"sound of {len(data)} octets")
        _, which, count, sequence, page_ms = _OWN_SOUND.unpack_from(data)
        if count != BLOCK_SAMPLES:
            raise ProtocolError(f"a block of {count} samples")
        return OwnSound(which, sequence, _finite(page_ms), memoryview(data)[_OWN_SOUND.size :])
    raise ProtocolError(f"a message of type {kind}")


def parse_request(text: str | bytes) -> Request:
    """Return a page's request. ProtocolError for anything else."""
    if len(text) > MOST_TEXT_OCTETS:
        raise ProtocolError(f"a request of {len(text)} characters")
    try:
        return _REQUESTS.decode(text)
    except (msgspec.DecodeError, RecursionError, UnicodeError):
        raise ProtocolError("a text that is no request") from None


def _own_picture(data: bytes) -> OwnPicture:
    if len(data) < _OWN.size:
        raise ProtocolError(f"a picture of {len(data)} octets")
    _, which, width, height, _, page_ms = _OWN.unpack_from(data)
    octets = width * height * 3 // 2
    if width % 2 or height % 2 or not octets or len(data) != _OWN.size + octets:
        raise ProtocolError(f"a picture of {width}x{height} in {len(data)} octets")
    return OwnPicture(which, width, height, _finite(page_ms), memoryview(data)[_OWN.size :])


def _check_size(layout: struct.Struct, data: bytes) -> None:
    if len(data) != layout.size:
        raise ProtocolError(f"a message of {len(data)} octets where {layout.size} are due")


def _finite(page_ms: float) -> float:
    if not math.isfinite(page_ms):
        raise ProtocolError("an instant that is no number")
    return page_ms


def _us(instant_ns: int | None) -> int:
    return _UNKNOWN_US if instant_ns is None else instant_ns // NS_PER_US
