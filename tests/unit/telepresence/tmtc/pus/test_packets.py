"""PUS packets octet by octet, after ECSS-E-ST-70-41C."""

import pytest
from pus_ends import command, report

from kontur_av.errors import ConfigError, ProtocolError
from telepresence.tmtc.pus import head
from telepresence.tmtc.pus.packets import cuc_from_ns, ns_from_cuc, pack_packet, parse_packet
from telepresence.tmtc.pus.verification import (
    MOST_REASON,
    Failure,
    Verification,
    VerificationStage,
    pack_verification,
    parse_verification,
    verification_of,
)


def check(octets):
    """Append the cyclic redundancy code of annex B.1, computed bit by bit."""
    data = bytes.fromhex(octets)
    register = 0xFFFF
    for octet in data:
        register ^= octet << 8
        for _ in range(8):
            register = (register << 1 ^ (0x1021 if register & 0x8000 else 0)) & 0xFFFF
    return data + register.to_bytes(2, "big")


#: Are-you-alive, 17,1, to APID 0x120, all flags, from source 2, count 5.
PING = check("1920 c005 0006 2f 11 01 0002")
#: Housekeeping, 3,25, of APID 0x120, counter 7, at 1.5 s, structure 1 and an octet.
HOUSEKEEPING = check("0920 c001 0010 20 03 19 0007 0102 00000001 8000 0102")
TIMED = cuc_from_ns(1_500_000_000)


@pytest.mark.parametrize(
    ("packet", "octets"),
    [
        (command(17, 1, count=5, apid=0x120, source=2), PING),
        (
            report(3, 25, b"\1\2", 1, apid=0x120, counter=7, destination=0x102, cuc=TIMED),
            HOUSEKEEPING,
        ),
    ],
)
def test_packets_have_these_octets(packet, octets):
    assert pack_packet(packet) == octets
    assert parse_packet(octets) == packet


@pytest.mark.parametrize("cuc", [0, 1, 65535, (1 << 48) - 1])
def test_time_survives_as_nanoseconds(cuc):
    assert cuc_from_ns(ns_from_cuc(cuc)) == cuc
    assert ns_from_cuc(TIMED) == 1_500_000_000


@pytest.mark.parametrize(
    "octets",
    [
        b"",
        PING[:-1],
        PING + b"\x00",
        PING[:-1] + bytes([PING[-1] ^ 1]),  # a wrong check
        check("3920 c005 0006 2f 11 01 0002"),  # version 1
        check("1120 c005 0006 2f 11 01 0002"),  # no secondary header
        check("1920 4005 0006 2f 11 01 0002"),  # a first segment
        check("1920 c005 0007 2f 11 01 0002"),  # a wrong length
        check("1920 c005 0006 1f 11 01 0002"),  # PUS A
        check("0920 c001 0010 21 03 19 0007 0000 00000001 8000 0102"),  # status of the time
        check("0920 c001 0006 20 03 19 0007"),  # no room for the time
        bytes(7),
        b"\x19\x20\xc0\x00\x00\x00" + b"\xff" * 300,
    ],
)
def test_other_octets_are_refused(octets):
    with pytest.raises(ProtocolError):
        parse_packet(octets)


def test_a_packet_has_at_most_256_octets():
    longest = pack_packet(command(8, 1, bytes(243)))
    assert len(longest) == 256 and head.is_packet(longest)
    with pytest.raises(ConfigError, match="257 octets: send at most 256"):
        pack_packet(command(8, 1, bytes(244)))
    assert not head.is_packet(longest[:4] + (250).to_bytes(2, "big") + longest[6:] + b"\0")


def test_the_head_of_a_packet_tells_what_it_is():
    for octets, message, is_command in ((PING, (17, 1), True), (HOUSEKEEPING, (3, 25), False)):
        assert (head.apid_of(octets), head.message_of(octets)) == (0x120, message)
        assert head.is_packet(octets)
        assert head.is_telecommand(octets) is is_command
        for wrong in (octets[:-1], octets + b"\0", octets[:12]):
            assert not head.is_packet(wrong)
        for at, octet in ((0, octets[0] | 0x20), (0, octets[0] ^ 8), (2, octets[2] & 0x7F)):
            assert not head.is_packet(octets[:at] + bytes([octet]) + octets[at + 1 :])
    shortest = pack_packet(report(17, 2, destination=0x102))
    assert (len(shortest), len(PING)) == (21, 13)
    assert (head.destination_of(shortest), head.destination_of(shortest[:20])) == (0x0102, 0)
    # A telecommand goes to its application however long it is.
    assert head.destination_of(pack_packet(command(8, 1, bytes(range(1, 21))))) == 0


@pytest.mark.parametrize(
    ("fields", "octets"),
    [
        ((VerificationStage.ACCEPTED,), "1920c005"),
        ((VerificationStage.COMPLETED,), "1920c005"),
        ((VerificationStage.COMPLETED, Failure.REFUSED, "hot"), "1920c005 04 686f74"),
        ((VerificationStage.STARTED, Failure.REFUSED, " ~"), "1920c005 04 207e"),
        *(((VerificationStage(stage), Failure.BUSY), "1920c005 05") for stage in (1, 3, 7, 9)),
    ],
)
def test_a_verification_names_its_telecommand(fields, octets):
    found = Verification(0x120, 5, *fields)
    assert pack_verification(found) == bytes.fromhex(octets)
    assert parse_verification(found.subtype, bytes.fromhex(octets)) == found
    assert found.subtype == fields[0] + (len(fields) > 1)


def test_reasons_are_printable_ascii_of_100_characters():
    cut = verification_of(
        command(), VerificationStage.STARTED, Failure.REFUSED, "~ \x7f\x1fé" + 100 * "x"
    )
    assert (cut.reason, MOST_REASON) == ("~ ???" + 95 * "x", 100)
    data = pack_verification(cut)
    assert parse_verification(cut.subtype, data) == cut
    with pytest.raises(ProtocolError):
        parse_verification(cut.subtype, data + b"x")
    most = parse_verification(2, bytes.fromhex("1fffffff05"))
    assert (most.apid, most.count) == (0x7FF, 0x3FFF)


@pytest.mark.parametrize(
    ("subtype", "octets"),
    [
        (5, "1a00c001"), (9, "1a00c001"), (1, "1a00c0"), (1, "1a00c00104"), (2, "1a00c001"),
        (1, "0a00c001"), (1, "1a008001"), (8, "1a00c00100"), (8, "1a00c00106"),
        (8, "1a00c001041f"), (8, "1a00c001047f"),
    ],
)  # fmt: skip
def test_verifications_of_no_telecommand_or_reason_are_garbage(subtype, octets):
    with pytest.raises(ProtocolError):
        parse_verification(subtype, bytes.fromhex(octets))
