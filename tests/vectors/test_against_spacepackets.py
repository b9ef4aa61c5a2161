"""Packets and frames against spacepackets, an independent implementation of the CCSDS books.

It knows space packets (CCSDS 133.0-B-2) and the CRC-16 of CCSDS 732.0-B-5, clause 4.1.6. It has
no AOS transfer frames; tests/vectors/test_aos_issue5.py has a decoder of those.
"""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from telepresence.link.frame import FrameCodec
from telepresence.link.profile import DOWNLINK, UPLINK
from telepresence.tmtc import Housekeeping, SelectAck, SelectCamera, pack_packet
from telepresence.tmtc.packets import COMMAND_APID, TELEMETRY_APID, parse_packet

ccsds = pytest.importorskip("spacepackets.ccsds")
ecss = pytest.importorskip("spacepackets.ecss")

NAMES = st.text("abcxyz019_", min_size=1, max_size=10)
MESSAGES = st.one_of(
    st.builds(SelectCamera, name=NAMES, token=st.integers(0, 0xFFFF)),
    st.builds(SelectAck, name=NAMES, token=st.integers(0, 0xFFFF), ok=st.booleans()),
    st.builds(Housekeeping, name=NAMES, contact=st.booleans(), force_n=st.just(1.0)),
)


@given(message=MESSAGES, count=st.integers(0, 0x3FFF))
def test_the_oracle_reads_our_packet_headers(message, count):
    packet = pack_packet(message, count)
    header = ccsds.SpacePacketHeader.unpack(packet)
    command = isinstance(message, SelectCamera)
    assert header.ccsds_version == 0
    assert header.packet_type == (ccsds.PacketType.TC if command else ccsds.PacketType.TM)
    assert header.apid == (COMMAND_APID if command else TELEMETRY_APID)
    assert header.seq_count == count
    assert header.seq_flags == ccsds.SequenceFlags.UNSEGMENTED
    assert not header.sec_header_flag
    assert header.packet_len == len(packet)


@given(message=MESSAGES, count=st.integers(0, 0x3FFF))
def test_we_read_the_packets_of_the_oracle(message, count):
    body = pack_packet(message, 0)[6:]
    command = isinstance(message, SelectCamera)
    header = ccsds.SpacePacketHeader(
        packet_type=ccsds.PacketType.TC if command else ccsds.PacketType.TM,
        apid=COMMAND_APID if command else TELEMETRY_APID,
        seq_count=count,
        data_len=len(body) - 1,
    )
    packet = parse_packet(bytes(header.pack()) + body)
    assert (packet.message, packet.count) == (message, count)


@pytest.mark.parametrize("profile", [UPLINK, DOWNLINK], ids=lambda profile: profile.name)
@given(count=st.integers(0, (1 << 24) - 1), seed=st.binary(min_size=1, max_size=8))
def test_the_check_of_a_frame_is_the_oracles(profile, count, seed):
    codec = FrameCodec(profile)
    zone = (seed * profile.packet_zone_octets)[: profile.packet_zone_octets]
    frames = [
        codec.pack(count, bytes(profile.insert_octets), 0, zone),
        codec.pack_idle(count, bytes(profile.insert_octets)),
        codec.pack_idle(count, None),
    ]
    for frame in frames:
        # The packet error control of ECSS is the CRC-16 of the transfer frame's FECF.
        assert ecss.check_pus_crc(frame)
        assert not ecss.check_pus_crc(bytes([frame[0] ^ 1]) + frame[1:])
