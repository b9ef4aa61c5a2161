"""ST[01]: what became of a telecommand: accepted, started, completed, or failed, and why.

A report's data is the telecommand's request identifier (the first 4 octets of its primary header,
clause 8.1.2.1). A failure adds a code of one octet and its reason in ASCII, at most 100 characters.
"""

import struct
from dataclasses import dataclass
from enum import IntEnum

from kontur_av.errors import ProtocolError
from telepresence.tmtc.pus.packets import Telecommand, Telemetry, cuc_from_ns, pack_packet

SERVICE = 1
MOST_REASON = 100

_REQUEST = struct.Struct(">HH")


class VerificationStage(IntEnum):
    """Subtype of a report of success; that of the failure is the next one (clause 8.1.2)."""

    ACCEPTED = 1
    STARTED = 3
    COMPLETED = 7
    #: Only as a failure: nobody here has that APID.
    ROUTED = 9

    @property
    def flag(self) -> int:
        """The telecommand's flag that asks for this stage."""
        return {
            VerificationStage.ACCEPTED: 8,
            VerificationStage.STARTED: 4,
            VerificationStage.COMPLETED: 1,
        }.get(self, 0)


class Failure(IntEnum):
    """Why a telecommand failed."""

    UNKNOWN_APID = 1
    UNKNOWN_MESSAGE = 2
    BAD_DATA = 3
    REFUSED = 4
    BUSY = 5


@dataclass(frozen=True, slots=True)
class Verification:
    """One report. failure: None for success. apid, count: of the telecommand."""

    apid: int
    count: int
    stage: VerificationStage
    failure: Failure | None = None
    reason: str = ""

    @property
    def subtype(self) -> int:
        """The message's subtype."""
        return self.stage + (self.failure is not None)


def verification_of(
    command: Telecommand, stage: VerificationStage, failure: Failure | None = None, reason: str = ""
) -> Verification:
    """Return the report about `command`; a reason is cut to what a report carries."""
    plain = "".join(c if " " <= c <= "~" else "?" for c in reason)[:MOST_REASON]
    return Verification(command.apid, command.count, stage, failure, plain)


def pack_verification(report: Verification) -> bytes:
    """Return the data of `report`."""
    request = _REQUEST.pack(0x1800 | report.apid, 0xC000 | report.count)
    if report.failure is None:
        return request
    return request + bytes([report.failure]) + report.reason.encode("ascii")


def pack_refusal(
    command: Telecommand, report: Verification, *, count: int, destination: int, unix_ns: int
) -> bytes:
    """Return a packet with a report by somebody who has no APID: it has that of the telecommand.

    count: of the reports of this kind. unix_ns: its instant, ns of Unix time.
    """
    return pack_packet(
        Telemetry(
            apid=command.apid,
            count=count,
            service=SERVICE,
            subtype=report.subtype,
            data=pack_verification(report),
            counter=count,
            destination=destination,
            cuc=cuc_from_ns(unix_ns),
        )
    )


def parse_verification(subtype: int, data: bytes) -> Verification:
    """Parse the data of a report; ProtocolError."""
    failed = subtype in (2, 4, 8, 10)
    if not failed and subtype not in (1, 3, 7):
        raise ProtocolError(f"verification of an unknown subtype {subtype}")
    if len(data) < _REQUEST.size + failed or (not failed and len(data) != _REQUEST.size):
        raise ProtocolError(f"verification of {len(data)} octets")
    identification, sequence = _REQUEST.unpack_from(data)
    if identification & 0xF800 != 0x1800 or sequence >> 14 != 3:
        raise ProtocolError("verification of no telecommand")
    apid, count, stage = (
        identification & 0x7FF,
        sequence & 0x3FFF,
        VerificationStage(subtype - failed),
    )
    if not failed:
        return Verification(apid, count, stage)
    code, reason = data[_REQUEST.size], data[_REQUEST.size + 1 :]
    if code not in set(Failure) or len(reason) > MOST_REASON:
        raise ProtocolError("verification with an unknown failure")
    if not all(0x20 <= octet <= 0x7E for octet in reason):
        raise ProtocolError("verification with a reason that is no text")
    return Verification(apid, count, stage, Failure(code), reason.decode("ascii"))
