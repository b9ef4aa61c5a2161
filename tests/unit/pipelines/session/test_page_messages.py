"""The binary messages, octet by octet, and what is no message."""

import struct

import numpy as np
import pytest

from kontur_av.errors import ProtocolError
from kontur_av.media import empty_picture
from pipelines.hand.haptic_trace import FIELDS, ROW
from pipelines.session import page_messages as messages
from telepresence.haptics.device.page import PageInput

SIZES = {0: (32, 16), 1: None}


def picture(index=0, width=32, height=16, octets=32 * 16 * 3 // 2):
    return struct.pack("<BBHHxxd", 0x83, index, width, height, 5.5) + bytes(octets)


def block(index=1, samples=960, page_ms=5.5, octets=2 * 960):
    return struct.pack("<BBHId", 0x84, index, samples, 7, page_ms) + bytes(octets)


def hand(dead_man=1, x=0.5, y=-1.0, picture_us=5.0):
    return struct.pack("<BBHIffd", 0x82, dead_man, 3, 9, x, y, picture_us)


def test_what_pages_are_sent():
    assert messages.pack_unit(2, 5, (1 << 32) + 7, -1, b"unit") == (
        b"\x01\x02\x05\x00\x07\x00\x00\x00" + b"\xff" * 8 + b"unit"
    )
    assert messages.pack_sound(1, 3, 1000, b"\x01\x02", concealed=True) == (
        b"\x02\x01\x01\x00\x03\x00\x00\x00\xe8\x03\x00\x00\x00\x00\x00\x00\x01\x02"
    )
    assert messages.pack_pong(1.0, 5) == struct.pack("<B7xdq", 5, 1.0, 5)
    nines = empty_picture(16, 16)
    nines[:] = 9
    assert (
        messages.pack_preview(3, 4, nines) == struct.pack("<BBHHxxq", 4, 3, 16, 16, 4) + b"\t" * 384
    )
    values = range(1, len(FIELDS) + 1)
    rows = np.array([(1_500, *values, 0x30201, -1, -1)] * 2, ROW)
    row = struct.pack(f"<d{len(FIELDS)}fI", 1.5, *values, 0x30201)  # its instant in microseconds
    assert messages.pack_haptic(1, rows) == struct.pack("<BBHI", 3, 1, 2, 0) + 2 * row


def test_what_pages_send():
    assert messages.parse_seat_message(struct.pack("<B7xd", 0x81, 2.5), 1) == messages.Ping(2.5)
    assert messages.parse_seat_message(hand(), 42) == PageInput(True, 0.5, -1.0, 3, 9, 42, 5000)
    shown, heard = picture(), block()
    assert messages.parse_media_message(shown, SIZES) == messages.OwnPicture(
        0, 5.5, memoryview(shown)[16:]
    )
    assert messages.parse_media_message(heard, SIZES) == messages.OwnSound(
        1, 7, 5.5, memoryview(heard)[16:]
    )
    assert messages.most_media_octets({0: (640, 480)}) == 16 + 640 * 480 * 3 // 2


NO_HANDS = [
    *(hand()[:-1], hand() + b"\0", picture(), b"", hand(dead_man=2)),
    *(hand(x=1.01), hand(y=float("nan")), hand(picture_us=float("inf"))),
]
NO_MEDIA = [
    *(picture()[:-1], picture() + b"\0", picture()[:15], picture(width=16, height=32)),
    *(picture(index=1), picture(index=2), block()[:-2], block(index=0), block(samples=480)),
    *(block(page_ms=float("nan")), hand()),
]


@pytest.mark.rule("10")
@pytest.mark.parametrize(
    ("parse", "data"),
    [
        *((lambda data: messages.parse_seat_message(data, 0), data) for data in NO_HANDS),
        *((lambda data: messages.parse_media_message(data, SIZES), data) for data in NO_MEDIA),
    ],
)
def test_what_is_out_of_its_range_size_or_input_is_refused(parse, data):
    # tests/fuzz/test_page_fuzz.py has the rest.
    with pytest.raises(ProtocolError):
        parse(data)
