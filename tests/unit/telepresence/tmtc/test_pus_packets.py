"""PUS packets octet by octet, after ECSS-E-ST-70-41C."""

import pytest

from kontur_av.errors import ConfigError, ProtocolError
from telepresence.tmtc.pus.packets import (
    Telecommand,
    Telemetry,
    cuc_from_ns,
    ns_from_cuc,
    pack_packet,
    parse_packet,
)
from telepresence.tmtc.pus.verification import (
    Failure,
    Verification,
    VerificationStage,
    pack_verification,
    parse_verification,
)


def check(octets: str) -> bytes:
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
HOUSEKEEPING = check("0920 c001 0010 20 03 19 0007 0000 00000001 8000 0102")


def test_a_telecommand_has_these_octets() -> None:
    ping = Telecommand(apid=0x120, count=5, service=17, subtype=1, source=2)
    assert pack_packet(ping) == PING
    assert parse_packet(PING) == ping


def test_a_report_has_these_octets() -> None:
    report = Telemetry(
        apid=0x120,
        count=1,
        service=3,
        subtype=25,
        data=b"\x01\x02",
        counter=7,
        cuc=cuc_from_ns(1_500_000_000),
    )
    assert pack_packet(report) == HOUSEKEEPING
    assert parse_packet(HOUSEKEEPING) == report
    assert ns_from_cuc(report.cuc) == 1_500_000_000


@pytest.mark.parametrize("cuc", [0, 1, 65535, (1 << 48) - 1])
def test_time_survives_as_nanoseconds(cuc: int) -> None:
    assert cuc_from_ns(ns_from_cuc(cuc)) == cuc


@pytest.mark.parametrize(
    ("report", "octets"),
    [
        (Verification(0x120, 5, VerificationStage.ACCEPTED), "1920c005"),
        (Verification(0x120, 5, VerificationStage.COMPLETED), "1920c005"),
        (
            Verification(0x120, 5, VerificationStage.COMPLETED, Failure.REFUSED, "hot"),
            "1920c005 04 686f74",
        ),
    ],
)
def test_a_verification_names_its_telecommand(report: Verification, octets: str) -> None:
    assert pack_verification(report) == bytes.fromhex(octets)
    assert parse_verification(report.subtype, bytes.fromhex(octets)) == report


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
    ],
)
def test_other_octets_are_refused(octets: bytes) -> None:
    with pytest.raises(ProtocolError):
        parse_packet(octets)


def test_a_packet_has_at_most_256_octets() -> None:
    command = Telecommand(apid=0x120, count=0, service=8, subtype=1, data=bytes(243))
    assert len(pack_packet(command)) == 256
    with pytest.raises(ConfigError, match="257 octets: send at most 256"):
        pack_packet(Telecommand(apid=0x120, count=0, service=8, subtype=1, data=bytes(244)))
