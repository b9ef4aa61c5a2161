"""Telecommands and telemetry: CCSDS space packets, and their retransmission."""

from telepresence.tmtc.exchange import (
    SelectDone,
    SelectFailed,
    TelecommandReceiver,
    TelecommandSender,
)
from telepresence.tmtc.packets import (
    COMMAND_APID,
    MAX_NAME_OCTETS,
    MAX_PACKET_OCTETS,
    TELEMETRY_APID,
    Housekeeping,
    Message,
    SelectAck,
    SelectCamera,
    SpacePacket,
    check_name,
    is_ours,
    pack_packet,
    parse_packet,
)

__all__ = [
    "COMMAND_APID",
    "MAX_NAME_OCTETS",
    "MAX_PACKET_OCTETS",
    "TELEMETRY_APID",
    "Housekeeping",
    "Message",
    "SelectAck",
    "SelectCamera",
    "SelectDone",
    "SelectFailed",
    "SpacePacket",
    "TelecommandReceiver",
    "TelecommandSender",
    "check_name",
    "is_ours",
    "pack_packet",
    "parse_packet",
]
