"""The first octets of PUS packets: enough to route them, without reading the rest."""

from typing import Final

MAX_PACKET_OCTETS: Final = 256
HEADER_OCTETS: Final = 6

_TELECOMMAND, _SECONDARY = 0x10, 0x08
#: The shortest telecommand: both headers and the check.
_LEAST_OCTETS = 13
#: The shortest telemetry.
_LEAST_REPORT_OCTETS = 21


def is_packet(data: bytes) -> bool:
    """Whether the primary header of `data` is one of a PUS packet; its check is not computed."""
    return (
        _LEAST_OCTETS <= len(data) <= MAX_PACKET_OCTETS
        and data[0] & ~0x17 == _SECONDARY  # version 0 and a secondary header
        and data[2] >> 6 == 3  # unsegmented
        and (data[4] << 8 | data[5]) == len(data) - HEADER_OCTETS - 1
    )


def apid_of(data: bytes) -> int:
    """The application of a packet for which `is_packet` holds."""
    return (data[0] & 0x07) << 8 | data[1]


def is_telecommand(data: bytes) -> bool:
    """Whether a packet for which `is_packet` holds is a telecommand."""
    return bool(data[0] & _TELECOMMAND)


def message_of(data: bytes) -> tuple[int, int]:
    """Service and subtype of a packet for which `is_packet` holds."""
    return data[7], data[8]


def destination_of(data: bytes) -> int:
    """To whom a report goes; 0 for everybody, and for a report that is cut."""
    if is_telecommand(data) or len(data) < _LEAST_REPORT_OCTETS:
        return 0
    return data[11] << 8 | data[12]
