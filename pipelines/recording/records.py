"""Records of MCAP and their octets, by the record classes of the `mcap` package. A core."""

import struct
from io import BytesIO
from typing import Final, TypeVar

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.records import (
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

MAGIC: Final = b"\x89MCAP0\r\n"
#: Every record: opcode, length of what follows.
HEAD: Final = struct.Struct("<BQ")
#: A chunk: instants of its first and last message, length and CRC-32 of what is in it. Then follow
#: the name of the compression and the compressed records, each behind its length.
CHUNK: Final = struct.Struct("<QQQI")
LENGTH_4, LENGTH_8 = struct.Struct("<I"), struct.Struct("<Q")
#: A message: channel, sequence number, instants of logging and publishing.
MESSAGE: Final = struct.Struct("<HIQQ")

Readable = (
    AttachmentIndex
    | Channel
    | ChunkIndex
    | DataEnd
    | Footer
    | Header
    | MessageIndex
    | Metadata
    | MetadataIndex
    | Schema
    | Statistics
    | SummaryOffset
)
Kind = TypeVar("Kind", bound=Readable)


def octets_of(record: McapRecord) -> bytes:
    """Return a record as it stands in a file."""
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())


def parse_record(kind: type[Kind], content: bytes) -> Kind | None:
    """Return the record in `content`, what follows opcode and length, or None for anything else.

    It is read strictly: the record, written again, has the same octets. More may follow, because
    later versions of the format may add fields.
    """
    try:
        record: Kind = kind.read(ReadDataStream(BytesIO(content)))
        again = octets_of(record)[HEAD.size :]
    except (McapError, struct.error, ValueError, OverflowError):
        return None
    return record if content.startswith(again) else None
