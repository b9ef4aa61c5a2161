"""The PDUs of CFDP, class 2: CCSDS 727.0-B-5, chapter 5, with the reserved messages of chapter 6.

The spacepackets package makes and parses the octets. This module says what is in them, and turns
whatever it raises on a peer's octets into a ProtocolError.
"""

import struct
from dataclasses import dataclass, field
from typing import NamedTuple

from spacepackets.cfdp import (
    ChecksumType,
    ConditionCode,
    DeliveryCode,
    Direction,
    DirectiveType,
    FileStatus,
    InvalidCrcError,
    LargeFileFlag,
    PduConfig,
    PduFactory,
    TlvType,
    TransactionId,
    TransmissionMode,
)
from spacepackets.cfdp.defs import UnsupportedCfdpVersionError
from spacepackets.cfdp.lv import CfdpLv
from spacepackets.cfdp.pdu import (
    AckPdu,
    EofPdu,
    FileDataPdu,
    FinishedPdu,
    KeepAlivePdu,
    MetadataPdu,
    NakPdu,
)
from spacepackets.cfdp.pdu.ack import TransactionStatus
from spacepackets.cfdp.pdu.file_data import FileDataParams
from spacepackets.cfdp.pdu.finished import FinishedParams
from spacepackets.cfdp.pdu.metadata import MetadataParams
from spacepackets.cfdp.tlv import (
    CfdpTlv,
    DirectoryListingRequest,
    DirectoryParams,
    FilestoreActionCode,
    FileStoreRequestTlv,
    FilestoreResponseStatusCode,
    FileStoreResponseTlv,
    MessageToUserTlv,
    OriginatingTransactionId,
    ProxyPutRequest,
    ProxyPutRequestParams,
    TlvTypeMissmatchError,
)
from spacepackets.exceptions import BytesTooShortError
from spacepackets.util import ByteFieldGenerator

from kontur_av.errors import ProtocolError
from telepresence.link.octet_streams import Range

__all__ = ["ChecksumType", "ConditionCode", "DirectiveType", "FileStatus"]

#: What asks for a file or a directory at the other end, or changes it there.
GET, LIST, RENAME, REMOVE = "get", "list", "rename", "remove"
#: A message to the user with the SHA-256 of the file. CFDP itself has sums of 32 bits only.
_SHA256 = b"sha256"
_SHA256_OCTETS = 32
_ACTIONS = {
    FilestoreActionCode.RENAME_FILE_SNP: RENAME,
    FilestoreActionCode.DELETE_FILE_SNN: REMOVE,
}
_STATUS = {
    RENAME: (
        FilestoreResponseStatusCode.RENAME_SUCCESS,
        FilestoreResponseStatusCode.RENAME_NOT_PERFORMED,
    ),
    REMOVE: (
        FilestoreResponseStatusCode.DELETE_SUCCESS,
        FilestoreResponseStatusCode.DELETE_NOT_ALLOWED,
    ),
}
_MOST_REASON_OCTETS = 60
#: What the package raises on octets of a peer.
_GARBAGE = (
    ValueError,
    IndexError,
    AssertionError,
    struct.error,
    BytesTooShortError,
    InvalidCrcError,
    TlvTypeMissmatchError,
    UnsupportedCfdpVersionError,
)


class Key(NamedTuple):
    """A transaction: who began it, for whom, its number, and how many octets these fields have."""

    source: int
    destination: int
    number: int
    id_octets: int = 1
    number_octets: int = 4


class Request(NamedTuple):
    """What is asked of the other end: GET, LIST, RENAME or REMOVE, with one or two names."""

    kind: str
    first: str
    second: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Metadata:
    """Clause 5.2.5. Without a destination there is no file.

    sha256: of the file, b"" if it is not told. origin: the transaction that asked for this one.
    """

    key: Key
    size: int = 0
    checksum: int = ChecksumType.CRC_32
    source: str = ""
    destination: str = ""
    sha256: bytes = b""
    origin: Key | None = None
    request: Request | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class FileData:
    """Clause 5.3."""

    key: Key
    offset: int
    data: bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class Eof:
    """Clause 5.2.2. A condition other than NO_ERROR cancels the transaction."""

    key: Key
    size: int
    checksum: bytes
    condition: int = ConditionCode.NO_ERROR


@dataclass(frozen=True, slots=True, kw_only=True)
class Finished:
    """Clause 5.2.3. request, reason: what was asked of the directory, and why it was refused."""

    key: Key
    condition: int = ConditionCode.NO_ERROR
    complete: bool = True
    status: int = FileStatus.FILE_RETAINED
    request: Request | None = None
    reason: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Ack:
    """Clause 5.2.4. of: the directive, EOF or Finished."""

    key: Key
    of: int
    condition: int = ConditionCode.NO_ERROR
    active: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class Nak:
    """Clause 5.2.6. ranges: of octets; metadata: the metadata are missing, too."""

    key: Key
    ranges: list[Range] = field(default_factory=list)
    metadata: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class KeepAlive:
    """Clause 5.2.8. octets: as far as the file has come."""

    key: Key
    octets: int


Pdu = Metadata | FileData | Eof | Finished | Ack | Nak | KeepAlive


def pack_pdu(pdu: Pdu) -> bytes:
    """Return the octets of a PDU. ValueError for a name longer than 255 octets."""
    key = pdu.key
    conf = PduConfig(
        source_entity_id=ByteFieldGenerator.from_int(key.id_octets, key.source),
        dest_entity_id=ByteFieldGenerator.from_int(key.id_octets, key.destination),
        transaction_seq_num=ByteFieldGenerator.from_int(key.number_octets, key.number),
        trans_mode=TransmissionMode.ACKNOWLEDGED,
    )
    match pdu:
        case FileData():
            made = FileDataPdu(conf, FileDataParams(file_data=pdu.data, offset=pdu.offset))
        case Metadata():
            whole = MetadataParams(
                closure_requested=False,
                checksum_type=ChecksumType(pdu.checksum),
                file_size=pdu.size,
                source_file_name=pdu.source or None,
                dest_file_name=pdu.destination or None,
            )
            made = MetadataPdu(conf, whole, _options(pdu))
        case Eof():
            condition = ConditionCode(pdu.condition)
            made = EofPdu(conf, pdu.checksum, pdu.size, condition_code=condition)
        case Ack():
            status = TransactionStatus.ACTIVE if pdu.active else TransactionStatus.TERMINATED
            made = AckPdu(conf, DirectiveType(pdu.of), ConditionCode(pdu.condition), status)
        case Nak():
            requests = [*([(0, 0)] if pdu.metadata else []), *pdu.ranges]
            made = NakPdu(conf, 0, pdu.ranges[-1][1] if pdu.ranges else 0, requests)
        case KeepAlive():
            made = KeepAlivePdu(conf, pdu.octets)
        case Finished():
            finished = FinishedParams(
                condition_code=ConditionCode(pdu.condition),
                delivery_code=DeliveryCode(not pdu.complete),
                file_status=FileStatus(pdu.status),
                file_store_responses=_responses(pdu),
            )
            made = FinishedPdu(conf, finished)
    return bytes(made.pack())


def _options(pdu: Metadata) -> list[CfdpTlv]:
    """The request to the other end, the origin and the SHA-256."""
    found = []
    match pdu.request:
        case Request(kind="get", first=first, second=second):
            there = ByteFieldGenerator.from_int(pdu.key.id_octets, pdu.key.source)
            names = ProxyPutRequestParams(there, CfdpLv.from_str(first), CfdpLv.from_str(second))
            found.append(ProxyPutRequest(names).tlv)
        case Request(kind="list", first=first, second=second):
            found.append(DirectoryListingRequest(DirectoryParams.from_strs(first, second)).tlv)
        case Request(kind=kind, first=first, second=second):
            action = next(code for code, name in _ACTIONS.items() if name == kind)
            asked = FileStoreRequestTlv(action, first, second)
            # As a plain TLV, because its own length counts letters, not octets.
            found.append(CfdpTlv(asked.tlv_type, asked.value))
    if pdu.origin is not None:
        origin = pdu.origin
        number = ByteFieldGenerator.from_int(origin.number_octets, origin.number)
        source = ByteFieldGenerator.from_int(origin.id_octets, origin.source)
        found.append(OriginatingTransactionId(TransactionId(source, number)).tlv)
    if pdu.sha256:
        found.append(MessageToUserTlv(_SHA256 + pdu.sha256).tlv)
    return found


def _responses(pdu: Finished) -> list[FileStoreResponseTlv]:
    if pdu.request is None or pdu.request.kind not in _STATUS:
        return []
    action = next(code for code, name in _ACTIONS.items() if name == pdu.request.kind)
    status = _STATUS[pdu.request.kind][bool(pdu.reason)]
    # The package's parser counts letters, not octets, so other letters would make it fail.
    first, second, reason = (
        text.encode("ascii", "replace")
        for text in (pdu.request.first, pdu.request.second, pdu.reason)
    )
    message = CfdpLv(reason[:_MOST_REASON_OCTETS])
    return [FileStoreResponseTlv(action, status, first.decode(), second.decode(), message)]


def parse_pdu(octets: bytes) -> Pdu:
    """Return the PDU. ProtocolError for other octets, and for PDUs that this end does not know."""
    try:
        return _parse(octets)
    except _GARBAGE as error:
        raise ProtocolError(f"no PDU: {error}") from None


def _parse(octets: bytes) -> Pdu:
    pdu = PduFactory.from_raw(octets)
    if pdu is None:
        raise ValueError("unknown directive")
    header = pdu.pdu_header
    if header.transmission_mode != TransmissionMode.ACKNOWLEDGED:
        raise ValueError("class 1")
    if header.file_flag != LargeFileFlag.NORMAL or header.packet_len != len(octets):
        raise ValueError("another size")
    source = header.source_entity_id
    key = Key(
        source.value,
        header.dest_entity_id.value,
        header.transaction_seq_num.value,
        source.byte_len,
        header.transaction_seq_num.byte_len,
    )
    onward = header.direction == Direction.TOWARDS_RECEIVER
    match pdu:
        case FileDataPdu() if onward:
            return FileData(key=key, offset=pdu.offset, data=pdu.file_data)
        case MetadataPdu() if onward:
            return _metadata(key, pdu)
        case EofPdu() if onward:
            return Eof(
                key=key,
                size=pdu.file_size,
                checksum=bytes(pdu.file_checksum),
                # The package's parser leaves the code in the upper four bits.
                condition=ConditionCode(octets[header.header_len + 1] >> 4),
            )
        case AckPdu() if onward == (pdu.directive_code_of_acked_pdu != DirectiveType.EOF_PDU):
            return Ack(
                key=key,
                of=pdu.directive_code_of_acked_pdu,
                condition=ConditionCode(pdu.condition_code_of_acked_pdu),
            )
        case NakPdu() if not onward:
            ranges = pdu.segment_requests or []
            if any(start > end for start, end in ranges):
                raise ValueError("a range ends before it begins")
            return Nak(
                key=key,
                ranges=[one for one in ranges if one[0] < one[1]],
                metadata=(0, 0) in ranges,
            )
        case KeepAlivePdu() if not onward:
            return KeepAlive(key=key, octets=pdu.progress)
        case FinishedPdu() if not onward:
            return _finished(key, pdu)
    raise ValueError("not for this direction")


def _metadata(key: Key, pdu: MetadataPdu) -> Metadata:
    sha256, origin, request = b"", None, None
    for tlv in pdu.options_as_tlv() or ():
        if tlv.tlv_type == TlvType.FILESTORE_REQUEST:
            asked = FileStoreRequestTlv.from_tlv(tlv)
            if request is not None or asked.action_code not in _ACTIONS:
                raise ValueError("another filestore request than one rename or one delete")
            kind = _ACTIONS[asked.action_code]
            request = Request(kind, asked.first_file_name, asked.second_file_name)
        elif tlv.tlv_type == TlvType.MESSAGE_TO_USER:
            message = MessageToUserTlv.from_tlv(tlv)
            value = bytes(message.value)
            if value.startswith(_SHA256) and len(value) == len(_SHA256) + _SHA256_OCTETS:
                sha256 = value[len(_SHA256) :]
            if not value.startswith(b"cfdp") or len(value) < 5:
                continue
            reserved = message.to_reserved_msg_tlv()
            if (put := reserved.get_proxy_put_request_params()) is not None:
                request = Request(GET, put.source_file_as_str, put.dest_file_as_str)
            elif (listed := reserved.get_dir_listing_request_params()) is not None:
                request = Request(LIST, listed.dir_path_as_str, listed.dir_file_name_as_str)
            elif (told := reserved.get_originating_transaction_id()) is not None:
                origin = Key(
                    told.source_id.value,
                    key.source,
                    told.seq_num.value,
                    told.source_id.byte_len,
                    told.seq_num.byte_len,
                )
    return Metadata(
        key=key,
        size=pdu.file_size,
        checksum=pdu.checksum_type,
        source=pdu.source_file_name or "",
        destination=pdu.dest_file_name or "",
        sha256=sha256,
        origin=origin,
        request=request,
    )


def _finished(key: Key, pdu: FinishedPdu) -> Finished:
    request, reason = None, ""
    for told in pdu.file_store_responses:
        kind = _ACTIONS.get(told.action_code, "")
        request = Request(kind, told.first_file_name, told.second_file_name)
        if kind and told.status_code != _STATUS[kind][0]:
            message = bytes(told.filestore_msg.value).decode(errors="replace")
            reason = message if message.isprintable() and message else "not done"
    return Finished(
        key=key,
        condition=pdu.condition_code,
        complete=pdu.delivery_code == DeliveryCode.DATA_COMPLETE,
        status=pdu.file_status,
        request=request,
        reason=reason,
    )
