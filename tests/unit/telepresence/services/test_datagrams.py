"""Datagrams of services: what is parsed as it was packed, and what is refused."""

import pytest
from service_pair import ServicePair

from kontur_av.errors import ProtocolError
from telepresence.services.datagrams import (
    MOST_OCTETS,
    PART_OCTETS,
    OpenService,
    ResetReason,
    ResetStream,
    StreamPart,
    is_service,
    pack_service,
    parse_service,
)

DATAGRAMS = [
    OpenService(5, 1 << 31, "ssh"),
    StreamPart(5, 6, 7, 8, 9),
    StreamPart(5, 6, 7, 8, 9, gap=3, data=bytes(PART_OCTETS)),
    StreamPart(5, 6, 7, 8, 9, data=b"a", last=True),
    StreamPart(5, 6, 7, 8, 9, ask=True),
    ResetStream(5, 0, ResetReason.IDLE),
]


@pytest.mark.parametrize("datagram", DATAGRAMS)
def test_datagrams_are_parsed_as_they_were_packed(datagram: object) -> None:
    octets = pack_service(datagram)  # type: ignore[arg-type]
    assert is_service(octets)
    assert len(octets) <= MOST_OCTETS
    assert parse_service(octets) == datagram


@pytest.mark.rule("7")
@pytest.mark.parametrize(
    "octets",
    [
        b"",
        b"\x40",
        b"\x41",
        b"\x41" + bytes(8),
        b"\x41" + bytes(8) + b"../x",
        b"\x41" + bytes(8) + b"a" * 33,
        b"\x42" + bytes(20),
        b"\x44" + b"\x01" * 21,
        b"\x42" + b"\x01" * 300,
        b"\x45" + bytes(8) + b"\x63",
    ],
)
def test_what_is_no_datagram_of_a_service_is_refused(octets: bytes) -> None:
    with pytest.raises(ProtocolError):
        parse_service(octets)
    pair = ServicePair()
    pair.ground.streams.handle_datagram(octets, pair.now_ns)
    assert pair.ground.streams.counts.service_garbage == 1
