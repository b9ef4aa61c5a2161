"""PUS packets: ECSS-E-ST-70-41C messages in CCSDS space packets (133.0-B-2), at most 256 octets.

| packet | octets after the primary header (6) |
|---|---|
| telecommand | version and flags, service, subtype, source (2); data; check (2) |
| telemetry | version, service, subtype, counter (2), destination (2), time (6); data; check (2) |

Clauses 7.4.3.1 and 7.4.4.1. The check is the cyclic redundancy code of annex B.1. The time is CUC
(CCSDS 301.0-B-4, clause 3.2) with 4 octets of seconds since 1970 and 2 octets of their fraction,
without a preamble. The spacepackets package makes and checks all of it.
"""

from dataclasses import dataclass

from spacepackets.ecss.tc import InvalidTcCrc16Error, PusTc
from spacepackets.ecss.tm import InvalidTmCrc16Error, PusTm

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ConfigError, ProtocolError
from telepresence.tmtc.pus.head import HEADER_OCTETS, MAX_PACKET_OCTETS, is_packet, is_telecommand

MAX_COMMAND_OCTETS = MAX_PACKET_OCTETS - 13
MAX_REPORT_OCTETS = MAX_PACKET_OCTETS - 21
#: Sequence counts have 14 bits.
COUNT_MODULUS = 1 << 14

_TIME_OCTETS = 6
#: Acknowledgement of acceptance, start, progress and completion (clause 8.2.1).
ALL_FLAGS = 0x0F


@dataclass(frozen=True, slots=True, kw_only=True)
class Telecommand:
    """A request for the application `apid`. flags: which stages shall be reported, 0 to 15."""

    apid: int
    count: int
    service: int
    subtype: int
    data: bytes = b""
    source: int = 0
    flags: int = ALL_FLAGS


@dataclass(frozen=True, slots=True, kw_only=True)
class Telemetry:
    """A report of the application `apid`. cuc: its time in units of 2^-16 s since 1970."""

    apid: int
    count: int
    service: int
    subtype: int
    data: bytes = b""
    counter: int = 0
    destination: int = 0
    cuc: int = 0


def cuc_from_ns(unix_ns: int) -> int:
    """Return CUC time, 4 octets of seconds and 2 of their fraction; it repeats after 136 years."""
    return (unix_ns << 16) // NS_PER_S & (1 << 48) - 1


def ns_from_cuc(cuc: int) -> int:
    """Return the instant, rounded up so that `cuc_from_ns` gives `cuc` again."""
    return -(-cuc * NS_PER_S >> 16)


def pack_packet(packet: Telecommand | Telemetry) -> bytes:
    """Return the octets of `packet`. ConfigError if it is longer than 256 octets."""
    if isinstance(packet, Telecommand):
        octets = PusTc(
            service=packet.service,
            message_subtype=packet.subtype,
            apid=packet.apid,
            app_data=packet.data,
            seq_count=packet.count,
            source_id=packet.source,
            ack_flags=packet.flags,
        ).pack()
    else:
        octets = PusTm(
            service=packet.service,
            message_subtype=packet.subtype,
            timestamp=packet.cuc.to_bytes(_TIME_OCTETS, "big"),
            source_data=packet.data,
            apid=packet.apid,
            seq_count=packet.count,
            message_counter=packet.counter,
            destination_id=packet.destination,
        ).pack()
    if len(octets) > MAX_PACKET_OCTETS:
        raise ConfigError(f"a packet of {len(octets)} octets: send at most {MAX_PACKET_OCTETS}")
    return bytes(octets)


def parse_packet(data: bytes) -> Telecommand | Telemetry:
    """Parse `data`; ProtocolError unless it is exactly one PUS packet with a good check."""
    if not is_packet(data):
        raise ProtocolError(f"{len(data)} octets that are no PUS packet")
    try:
        return _parse_telecommand(data) if is_telecommand(data) else _parse_telemetry(data)
    except (ValueError, InvalidTcCrc16Error, InvalidTmCrc16Error) as error:
        raise ProtocolError(f"no PUS packet: {type(error).__name__}") from error


def _parse_telecommand(data: bytes) -> Telecommand:
    packet = PusTc.unpack(data)
    return Telecommand(
        apid=packet.apid,
        count=packet.seq_count,
        service=packet.service,
        subtype=packet.message_subtype,
        data=packet.app_data,
        source=packet.source_id,
        flags=packet.pus_tc_sec_header.ack_flags,
    )


def _parse_telemetry(data: bytes) -> Telemetry:
    if len(data) < MAX_PACKET_OCTETS - MAX_REPORT_OCTETS:
        raise ProtocolError("telemetry without its whole secondary header")
    if data[HEADER_OCTETS] & 0x0F:
        raise ProtocolError("telemetry with an unknown status of its time")
    packet = PusTm.unpack(data, _TIME_OCTETS)
    return Telemetry(
        apid=packet.apid,
        count=packet.seq_count,
        service=packet.service,
        subtype=packet.message_subtype,
        data=bytes(packet.source_data),
        counter=packet.pus_tm_sec_header.message_counter,
        destination=packet.pus_tm_sec_header.dest_id,
        cuc=int.from_bytes(packet.timestamp, "big"),
    )
