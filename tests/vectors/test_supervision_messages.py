"""The supervision message octet by octet, as docs/link-format.md defines it."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from telepresence.link.clock_exchange import (
    NO_AGE_US,
    ClockMessage,
    message_mark,
    pack_clock,
    parse_clock,
)
from telepresence.link.flows import Level, packet_flow, voice_flow
from telepresence.link.profile import DOWNLINK, UPLINK
from telepresence.link.supervision.message import (
    Configuration,
    LinkState,
    MessageKind,
    SupervisionMessage,
    message_version,
    pack_message,
    parse_message,
)
from telepresence.link.supervision.supervisor import Supervisor

ALIVE = SupervisionMessage(
    version=1,
    kind=MessageKind.ALIVE,
    state=LinkState.CONNECTED,
    master=True,
    signal=True,
    application=True,
    fresh=False,
    sending=True,
    life=0x1234,
    heard=0xABCD,
    digest=0x55AA,
    contexts=(7, 0, 255, 1),
)
VECTORS = [
    (ALIVE, "10 9d 1234 abcd 55aa 0700ff01"),
    (
        SupervisionMessage(
            version=1,
            kind=MessageKind.CONFIGURE,
            state=LinkState.CONFIGURE,
            master=True,
            signal=True,
            application=False,
            fresh=False,
            sending=False,
            life=1,
            heard=2,
            digest=3,
            rates_kbps=(256, 4000),
        ),
        "11 58 0001 0002 0003 0100 0fa0",
    ),
    (
        SupervisionMessage(
            version=1,
            kind=MessageKind.CONFIRM,
            state=LinkState.APPROVE,
            master=False,
            signal=True,
            application=True,
            fresh=True,
            sending=False,
            life=2,
            heard=1,
            digest=3,
            contexts=(0, 9, 0, 0),
        ),
        "12 6e 0002 0001 0003 00090000",
    ),
    (
        SupervisionMessage(
            version=15,
            kind=MessageKind.REJECT,
            state=LinkState.REFUSED,
            master=False,
            signal=False,
            application=False,
            fresh=False,
            sending=False,
            life=0xFFFF,
            heard=0,
            digest=0,
            rates_kbps=(4000, 256),
        ),
        "f3 a0 ffff 0000 0000 0fa0 0100",
    ),
    (
        SupervisionMessage(
            version=2,
            kind=MessageKind.HELLO,
            state=LinkState.SEARCH,
            master=True,
            signal=False,
            application=False,
            fresh=False,
            sending=True,
            life=0x1234,
            heard=0,
            digest=0x55AA,
            number=0xABCDEF,
            echo=0x000102,
        ),
        "24 31 1234 55aa abcdef 000102",
    ),
]


@pytest.mark.parametrize(("message", "octets"), VECTORS)
def test_golden(message, octets):
    assert pack_message(message) == bytes.fromhex(octets)
    assert parse_message(bytes.fromhex(octets)) == message


@pytest.mark.parametrize(
    ("octets", "what"),
    [
        ("009d1234abcd55aa0700ff01", "version 0"),
        ("159d1234abcd55aa0700ff01", "kind 5"),
        ("10dd1234abcd55aa0700ff01", "state 6"),
        ("109d0000abcd55aa0700ff01", "life 0"),
        ("129d1234abcd55aa0700ff01", "CONFIRM of a master"),
        ("118d1234abcd55aa0700ff01", "CONFIGURE of a slave"),
        ("109d1234abcd55aa0700ff", "too short"),
        ("109d1234abcd55aa0700ff0101", "too long"),
        ("", "nothing"),
    ],
)
def test_impossible_messages_are_refused(octets, what):
    assert parse_message(bytes.fromhex(octets)) is None, what


@given(st.binary(min_size=12, max_size=12))
def test_packing_restores_what_was_parsed(data):
    message = parse_message(data)
    if message is not None:
        assert message_version(data) == message.version
        assert pack_message(message) == data


CLOCKS = [
    (ClockMessage(2, True, 0x1234, 0xFEDCBA98, 0xDC, 0x010203), "25 10 1234 fedcba98 dc 010203"),
    (ClockMessage(2, False, 1, 0, 0, NO_AGE_US), "25 00 0001 00000000 00 ffffff"),
    (ClockMessage(2, True, 1, 7, 0, NO_AGE_US, 3, 0x15), "25 f5 0001 00000007 00 ffffff"),
    (ClockMessage(2, False, 1, 7, 0, NO_AGE_US, 2, 0x0A), "25 8a 0001 00000007 00 ffffff"),
]


@pytest.mark.parametrize(("message", "octets"), CLOCKS)
def test_clock_golden(message, octets):
    assert pack_clock(message) == bytes.fromhex(octets)
    assert parse_clock(bytes.fromhex(octets)) == message
    assert parse_message(bytes.fromhex(octets)) is None


def test_a_clock_is_known_by_bits_of_its_instant():
    assert message_mark(0xFEDCBA98) == 0xDC


@pytest.mark.parametrize(
    ("octets", "what"),
    [
        ("251000000000000000000000", "life 0"),
        ("051012340000000000000000", "version 0"),
        ("241012340000000000000000", "another kind"),
        ("2510123400000000000000", "too short"),
    ],
)
def test_impossible_clocks_are_refused(octets, what):
    assert parse_clock(bytes.fromhex(octets)) is None, what


@given(st.binary(min_size=12, max_size=12))
def test_packing_restores_what_was_parsed_of_a_clock(data):
    data = bytes([data[0] & 0xF0 | 5]) + data[1:]
    message = parse_clock(data)
    if message is not None:
        assert pack_clock(message) == data


UP = [packet_flow("tc", Level.TMTC), voice_flow("voice")]
DOWN = [packet_flow("tm", Level.TMTC)]
GROUND = Configuration(transmit=UPLINK, transmit_flows=UP, receive=DOWNLINK, receive_flows=DOWN)
SPACE = Configuration(transmit=DOWNLINK, transmit_flows=DOWN, receive=UPLINK, receive_flows=UP)
TEXT = """\
32 12 1000000 75 0 1
tc 0 raw 0 0
voice 1 rtp 48000 960
500 12 1000000 76 1 0
tm 0 raw 0 0
"""


def test_digest_is_the_crc_of_the_text_at_both_ends():
    assert GROUND.text(master=True) == SPACE.text(master=False) == TEXT
    assert GROUND.digest(master=True) == SPACE.digest(master=False) == crc16(TEXT.encode())
    # The digest includes which end is the master, because the directions differ.
    assert GROUND.digest(master=True) != SPACE.digest(master=True)


def crc16(data):
    """Return the CRC with x^16 + x^12 + x^5 + 1 from all ones, by bits (732.0-B-5, 4.1.6.2)."""
    register = 0xFFFF
    for octet in data:
        for bit in range(7, -1, -1):
            out = register >> 15 ^ octet >> bit & 1
            register = (register << 1 & 0xFFFF) ^ (0x1021 if out else 0)
    return register


def test_first_message_of_a_ground_station():
    supervisor = Supervisor(master=True, configuration=GROUND, life=0x1234, now_ns=0)
    supervisor.handle_local_check(None, 0)
    digest = f"{crc16(TEXT.encode()):04x}"
    message = supervisor.poll_transmit(0).hex()
    # A HELLO of version 3 with a fresh number; nothing was heard that it could echo.
    assert message[:12] == f"34301234{digest}"
    assert int(message[12:18], 16) > 0
    assert message[18:] == "000000"
