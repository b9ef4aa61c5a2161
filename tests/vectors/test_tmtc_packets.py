"""Space packets octet by octet: computed by hand from CCSDS 133.0-B-2, clause 4.1.3."""

import pytest

from kontur_av.errors import ConfigError, ProtocolError
from telepresence.tmtc import (
    MAX_PACKET_OCTETS,
    Housekeeping,
    SelectAck,
    SelectCamera,
    SpacePacket,
    pack_packet,
    parse_packet,
)

# 000 1 0 00100000001 | 11 00000000000101 | length 9 - 1 = 8 | 01, token, "static"
SELECT = bytes.fromhex("1101 c005 0008 01 beef") + b"static"
# 000 0 0 00100000010 | 11 11111111111111 | length 7 - 1 = 6 | 82 (refused), token, "left"
REFUSED = bytes.fromhex("0102 ffff 0006 82 0001") + b"left"
DONE = bytes.fromhex("0102 c000 0008 81 ffff") + b"static"
# flags 01 (contact), 7 N = 3500 counts = 0x0DAC
HOUSEKEEPING = bytes.fromhex("0102 c001 0007 83 01 0dac") + b"head"

VECTORS = [
    (SELECT, SpacePacket(5, SelectCamera("static", 0xBEEF))),
    (REFUSED, SpacePacket(16383, SelectAck("left", 1, ok=False))),
    (DONE, SpacePacket(0, SelectAck("static", 65535, ok=True))),
    (HOUSEKEEPING, SpacePacket(1, Housekeeping("head", contact=True, force_n=7.0))),
]


@pytest.mark.parametrize(("octets", "packet"), VECTORS)
def test_golden(octets: bytes, packet: SpacePacket) -> None:
    assert pack_packet(packet.message, packet.count) == octets
    assert parse_packet(octets) == packet
    assert pack_packet(packet.message, packet.count + 16384) == octets


def test_the_longest_packet_has_twenty_octets() -> None:
    longest = max(
        len(pack_packet(message, 0))
        for message in (
            SelectCamera("x" * 10, 0),
            SelectAck("x" * 10, 0, ok=True),
            Housekeeping("x" * 10, contact=False, force_n=0.0),
        )
    )
    assert longest == MAX_PACKET_OCTETS == 20


@pytest.mark.parametrize("name", ["", "x" * 11, "käfer", "a\nb"])
def test_an_unfit_name_is_a_config_error(name: str) -> None:
    with pytest.raises(ConfigError, match="1 to 10 printable ASCII"):
        pack_packet(SelectCamera(name, 0), 0)


@pytest.mark.parametrize(
    "octets",
    [
        b"",
        SELECT[:6],
        SELECT[:-1],
        SELECT + b"c",
        b"\x31" + SELECT[1:],  # version 1
        b"\x19" + SELECT[1:],  # a secondary header
        b"\x01" + SELECT[1:],  # a telecommand's APID on telemetry
        SELECT[:2] + b"\x40" + SELECT[3:],  # a first segment
        SELECT[:6] + b"\x81" + SELECT[7:],  # telemetry under the telecommand's APID
        SELECT[:9] + b"st\x00tic",
        HOUSEKEEPING[:7] + b"\x03" + HOUSEKEEPING[8:],  # an unknown flag
        HOUSEKEEPING[:8] + b"\x80\x00" + HOUSEKEEPING[10:],
        bytes.fromhex("1101 c005 0000 01"),
        bytes.fromhex("0102 c005 0002 83 00 00"),
    ],
)
def test_what_is_no_packet_of_ours_is_refused(octets: bytes) -> None:
    with pytest.raises(ProtocolError):
        parse_packet(octets)
