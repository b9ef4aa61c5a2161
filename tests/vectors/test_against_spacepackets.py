"""Packets against spacepackets, an independent implementation of the CCSDS books.

It knows space packets (CCSDS 133.0-B-2), but no AOS transfer frames:
tests/vectors/test_aos_issue5.py has a decoder of those.
"""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from telepresence.haptics.mediated.wall import WALL_APID, WallMessage, pack_wall, parse_wall

ccsds = pytest.importorskip("spacepackets.ccsds")


@given(stamp_ms=st.integers(0, 0xFF_FFFF), count=st.integers(0, 0x3FFF))
def test_the_oracle_reads_our_packet_headers(stamp_ms, count):
    packet = pack_wall(WallMessage(stamp_ms, None), count)
    header = ccsds.SpacePacketHeader.unpack(packet)
    assert header.ccsds_version == 0
    assert header.packet_type == ccsds.PacketType.TM
    assert header.apid == WALL_APID
    assert header.seq_count == count
    assert header.seq_flags == ccsds.SequenceFlags.UNSEGMENTED
    assert not header.sec_header_flag
    assert header.packet_len == len(packet)


@given(stamp_ms=st.integers(0, 0xFF_FFFF), count=st.integers(0, 0x3FFF))
def test_we_read_the_packets_of_the_oracle(stamp_ms, count):
    message = WallMessage(stamp_ms, None)
    body = pack_wall(message, 0)[6:]
    header = ccsds.SpacePacketHeader(
        packet_type=ccsds.PacketType.TM, apid=WALL_APID, seq_count=count, data_len=len(body) - 1
    )
    assert parse_wall(bytes(header.pack()) + body) == message
