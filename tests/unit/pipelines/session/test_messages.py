"""The binary messages, octet by octet, and what is no message."""

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kontur_av.errors import ProtocolError
from kontur_av.media import empty_picture
from pipelines.hand.haptic_trace import ROW
from pipelines.session.messages import (
    OwnPicture,
    OwnSound,
    Ping,
    most_media_octets,
    pack_haptic,
    pack_pong,
    pack_preview,
    pack_sound,
    pack_unit,
    parse_media_message,
    parse_seat_message,
)
from telepresence.haptics.device.page import PageInput

SIZES = {0: (32, 16), 1: None}
PICTURE = struct.pack("<BBHHxxd", 0x83, 0, 32, 16, 5.5) + bytes(32 * 16 * 3 // 2)
BLOCK = struct.pack("<BBHId", 0x84, 1, 960, 7, 5.5) + bytes(2 * 960)
HAND = struct.pack("<BBHIffd", 0x82, 1, 3, 9, 0.5, -1.0, 5.5)


def test_what_pages_are_sent():
    assert pack_unit(2, 5, (1 << 32) + 7, -1, b"unit") == (
        b"\x01\x02\x05\x00\x07\x00\x00\x00" + b"\xff" * 8 + b"unit"
    )
    assert pack_sound(1, 3, 1000, b"\x01\x02", concealed=True) == (
        b"\x02\x01\x01\x00\x03\x00\x00\x00\xe8\x03\x00\x00\x00\x00\x00\x00\x01\x02"
    )
    assert pack_pong(1.0, 5) == struct.pack("<B7xdq", 5, 1.0, 5)
    picture = empty_picture(16, 16)
    picture[:] = 9
    assert pack_preview(3, 4, picture) == struct.pack("<BBHHxxq", 4, 3, 16, 16, 4) + b"\t" * 384


def test_a_row_of_haptics_has_its_instant_in_microseconds():
    rows = np.array([(1_500, 1, 2, 3, 4, 5, 0x30201, -1, -1)] * 2, ROW)
    message = pack_haptic(1, rows)
    assert message[:8] == struct.pack("<BBHI", 3, 1, 2, 0)
    assert message[8:40] == struct.pack("<d5fI", 1.5, 1, 2, 3, 4, 5, 0x30201)
    assert len(message) == 8 + 2 * 32


def test_what_pages_send():
    assert parse_seat_message(struct.pack("<B7xd", 0x81, 2.5), 1) == Ping(2.5)
    assert parse_seat_message(HAND, 42) == PageInput(True, 0.5, -1.0, 3, 9, 42)
    assert parse_media_message(PICTURE, SIZES) == OwnPicture(0, 5.5, memoryview(PICTURE)[16:])
    assert parse_media_message(BLOCK, SIZES) == OwnSound(1, 7, 5.5, memoryview(BLOCK)[16:])
    assert most_media_octets({0: (640, 480)}) == 16 + 640 * 480 * 3 // 2


@pytest.mark.parametrize(
    "hand",
    [
        HAND[:-1],
        HAND + b"\0",
        struct.pack("<BBHIffd", 0x82, 2, 0, 0, 0.0, 0.0, 0.0),
        struct.pack("<BBHIffd", 0x82, 1, 0, 0, 1.01, 0.0, 0.0),
        struct.pack("<BBHIffd", 0x82, 1, 0, 0, 0.0, float("nan"), 0.0),
        struct.pack("<BBHIffd", 0x82, 1, 0, 0, 0.0, 0.0, float("inf")),
        PICTURE,
        b"",
    ],
)
def test_no_hand_that_is_out_of_its_range_or_size(hand):
    with pytest.raises(ProtocolError):
        parse_seat_message(hand, 0)


@pytest.mark.parametrize(
    "data",
    [
        PICTURE[:-1],
        PICTURE + b"\0",
        PICTURE[:15],
        struct.pack("<BBHHxxd", 0x83, 0, 16, 32, 5.5) + bytes(32 * 16 * 3 // 2),
        PICTURE[:1] + b"\x01" + PICTURE[2:],
        PICTURE[:1] + b"\x02" + PICTURE[2:],
        BLOCK[:-2],
        BLOCK[:1] + b"\x00" + BLOCK[2:],
        struct.pack("<BBHId", 0x84, 1, 480, 7, 5.5) + bytes(2 * 960),
        struct.pack("<BBHId", 0x84, 1, 960, 7, float("nan")) + bytes(2 * 960),
        HAND,
    ],
)
def test_no_picture_or_sound_of_another_size_or_input(data):
    with pytest.raises(ProtocolError):
        parse_media_message(data, SIZES)


@given(st.binary(max_size=64) | st.builds(bytes.__add__, st.just(b"\x82"), st.binary(max_size=30)))
def test_any_octets_are_a_message_or_refused(data):
    for parse in (lambda: parse_seat_message(data, 0), lambda: parse_media_message(data, SIZES)):
        try:
            message = parse()
        except ProtocolError:
            continue
        if isinstance(message, PageInput):
            assert abs(message.x) <= 1 and abs(message.y) <= 1
