"""Makes the octets of an MCAP file, in pieces that survive a killed process. A core.

The writer of the `mcap` package ends a chunk by its size alone, so a slow recording would keep
minutes in memory. Here a chunk also ends by time. Each one repeats the schemas and channels of its
messages. So it can be read alone, however much of the file before it is damaged, and its CRC-32
covers all that is needed to read it.

Written after the MCAP specification, https://mcap.dev/spec. Records are the classes of `mcap`.
"""

import struct
from binascii import crc32
from collections import Counter, deque
from collections.abc import Mapping
from io import BytesIO
from types import MappingProxyType
from typing import Final, NamedTuple, TypeVar

import zstandard
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
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

from kontur_av.clock import NS_PER_MS

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
    Attachment
    | AttachmentIndex
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
        if isinstance(record, Attachment):
            # Read without its check, which may be 0, and written with it.
            again = again[: -LENGTH_4.size]
    except (McapError, struct.error, ValueError, OverflowError):
        return None
    return record if content.startswith(again) else None


#: A chunk that is not full ends this long after its first message. So a file that is cut within a
#: chunk lacks this chunk and the one after it: less than a second.
CHUNK_NS = 400 * NS_PER_MS
#: A chunk has at most these octets before compression, unless one message alone is longer.
CHUNK_OCTETS = 256 * 1024
ZSTD = "zstd"
#: The cheapest level: pictures and sound are compressed already.
_ZSTD_LEVEL = 1


NO_MESSAGES: Mapping[int, int] = MappingProxyType({})


class Piece(NamedTuple):
    """Octets of a file, and how many messages of each channel are in them."""

    octets: bytes
    messages: Mapping[int, int]


class McapStream:
    """One file. Write what `poll_transmit` returns, in order and without a gap, until it is None.

    Call `poll_transmit` after each `handle_...` and at `poll_timeout`. After `handle_end` and the
    last octets the file is closed, and nothing more may be handled.

    A message is packed into the open chunk; a chunk that has ended waits until it is fetched. While
    more than `most_waiting_octets` wait, messages are refused.

    library: who writes the file, for its header.
    """

    def __init__(self, *, library: str, most_waiting_octets: int | None = None) -> None:
        self.octets = 0
        self.waiting_octets = 0
        self._most_waiting_octets = most_waiting_octets
        self._compressor = zstandard.ZstdCompressor(level=_ZSTD_LEVEL)
        self._waiting: deque[Piece] = deque()
        self._crc = 0
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        #: By channel: the records of its schema and of itself, for each chunk.
        self._definitions: dict[int, tuple[bytes, ...]] = {}
        self._chunk = _OpenChunk()
        self._chunk_indexes: list[ChunkIndex] = []
        self._metadata_indexes: list[MetadataIndex] = []
        self._attachment_indexes: list[AttachmentIndex] = []
        self._counts: Counter[int] = Counter()
        self._first_ns = self._last_ns = 0
        self._ended = False
        self._emit(MAGIC + octets_of(Header(profile="", library=library)))

    def handle_channel(self, schema: Schema | None, channel: Channel) -> None:
        """Declare a channel before its first message. schema: None for messages without one.

        Raises ValueError for an identifier that already stands for something else: a bug.
        """
        if self._channels.setdefault(channel.id, channel) != channel:
            raise ValueError(f"channel {channel.id} is already {self._channels[channel.id].topic}")
        if schema is not None and self._schemas.setdefault(schema.id, schema) != schema:
            raise ValueError(f"schema {schema.id} is already {self._schemas[schema.id].name}")
        records = (channel,) if schema is None else (schema, channel)
        self._definitions[channel.id] = tuple(octets_of(record) for record in records)
        self._chunk.define(self._definitions[channel.id])

    def handle_message(
        self,
        channel_id: int,
        data: bytes,
        *,
        log_ns: int,
        publish_ns: int,
        sequence: int,
        now_ns: int,
    ) -> bool:
        """Take a message of a declared channel; False: it was refused.

        log_ns, publish_ns: wall time, not negative. sequence: 32 bits, the rest is cut off.
        """
        most_octets = self._most_waiting_octets
        if most_octets is not None and self.waiting_octets > most_octets:
            return False
        head = MESSAGE.pack(channel_id, sequence & 0xFFFFFFFF, log_ns, publish_ns)
        record = HEAD.pack(Opcode.MESSAGE, len(head) + len(data)) + head + data
        definitions = self._definitions[channel_id]
        chunk = self._chunk
        begun_ns = chunk.begun_ns
        if begun_ns is not None and (
            now_ns - begun_ns >= CHUNK_NS
            or chunk.octets_with(definitions) + len(record) > CHUNK_OCTETS
        ):
            self._end_chunk()
            chunk = self._chunk
        chunk.define(definitions)
        chunk.add(channel_id, record, log_ns, now_ns)
        if not self._counts:
            self._first_ns = self._last_ns = log_ns
        self._counts[channel_id] += 1
        self._first_ns = min(self._first_ns, log_ns)
        self._last_ns = max(self._last_ns, log_ns)
        return True

    def handle_metadata(self, name: str, items: Mapping[str, str]) -> None:
        """Write a metadata record, behind what has been handled so far."""
        self._end_chunk()
        record = octets_of(Metadata(name=name, metadata=dict(items)))
        self._metadata_indexes.append(
            MetadataIndex(offset=self.octets, length=len(record), name=name)
        )
        self._emit(record)

    def handle_attachment(self, attachment: Attachment) -> None:
        """Write a file that a user has attached, behind what has been handled so far."""
        self._end_chunk()
        record = octets_of(attachment)
        self._attachment_indexes.append(
            AttachmentIndex(
                offset=self.octets,
                length=len(record),
                log_time=attachment.log_time,
                create_time=attachment.create_time,
                data_size=len(attachment.data),
                name=attachment.name,
                media_type=attachment.media_type,
            )
        )
        self._emit(record)

    def handle_end(self) -> None:
        self._end_chunk()
        self._emit(octets_of(DataEnd(data_section_crc=self._crc)))
        self._emit(self._summary())
        self._ended = True

    def poll_timeout(self) -> int | None:
        """When the open chunk ends; None while there is none."""
        begun_ns = self._chunk.begun_ns
        return None if begun_ns is None else begun_ns + CHUNK_NS

    def poll_transmit(self, now_ns: int) -> bytes | None:
        """Return the next octets of the file, or None."""
        piece = self.poll_piece(now_ns)
        return None if piece is None else piece.octets

    def poll_piece(self, now_ns: int) -> Piece | None:
        """As `poll_transmit`, with the number of messages in the octets."""
        due_ns = self.poll_timeout()
        if due_ns is not None and now_ns >= due_ns:
            self._end_chunk()
        if not self._waiting:
            return None
        piece = self._waiting.popleft()
        self.waiting_octets -= len(piece.octets)
        return piece

    def _emit(self, octets: bytes, messages: Mapping[int, int] = NO_MESSAGES) -> None:
        if self._ended:
            raise ValueError("the file has its summary already")
        self._waiting.append(Piece(octets, messages))
        self.waiting_octets += len(octets)
        self.octets += len(octets)
        self._crc = crc32(octets, self._crc)

    def _end_chunk(self) -> None:
        chunk, self._chunk = self._chunk, _OpenChunk()
        if not chunk.octets:
            return
        plain = b"".join(chunk.records)
        packed = self._compressor.compress(plain)
        record = octets_of(
            Chunk(
                compression=ZSTD,
                data=packed,
                message_start_time=chunk.first_ns,
                message_end_time=chunk.last_ns,
                uncompressed_crc=crc32(plain),
                uncompressed_size=len(plain),
            )
        )
        offsets: dict[int, int] = {}
        indexes = bytearray()
        for channel_id, entries in chunk.indexes.items():
            offsets[channel_id] = self.octets + len(record) + len(indexes)
            indexes += octets_of(MessageIndex(channel_id=channel_id, records=entries))
        self._chunk_indexes.append(
            ChunkIndex(
                chunk_start_offset=self.octets,
                chunk_length=len(record),
                compression=ZSTD,
                compressed_size=len(packed),
                uncompressed_size=len(plain),
                message_start_time=chunk.first_ns,
                message_end_time=chunk.last_ns,
                message_index_length=len(indexes),
                message_index_offsets=offsets,
            )
        )
        messages = {channel_id: len(entries) for channel_id, entries in chunk.indexes.items()}
        self._emit(record + indexes, messages)

    def _summary(self) -> bytes:
        """The summary, the offsets of its groups, the footer, and the magic octets of the end."""
        statistics = Statistics(
            attachment_count=len(self._attachment_indexes),
            channel_count=len(self._channels),
            channel_message_counts=dict(self._counts),
            chunk_count=len(self._chunk_indexes),
            message_count=self._counts.total(),
            message_start_time=self._first_ns,
            message_end_time=self._last_ns,
            metadata_count=len(self._metadata_indexes),
            schema_count=len(self._schemas),
        )
        groups: tuple[tuple[Opcode, list[McapRecord]], ...] = (
            (Opcode.SCHEMA, [*self._schemas.values()]),
            (Opcode.CHANNEL, [*self._channels.values()]),
            (Opcode.STATISTICS, [statistics]),
            (Opcode.CHUNK_INDEX, [*self._chunk_indexes]),
            (Opcode.METADATA_INDEX, [*self._metadata_indexes]),
            (Opcode.ATTACHMENT_INDEX, [*self._attachment_indexes]),
        )
        summary, offsets = bytearray(), bytearray()
        for opcode, records in groups:
            if records:
                group = b"".join(octets_of(record) for record in records)
                offsets += octets_of(
                    SummaryOffset(
                        group_opcode=opcode,
                        group_start=self.octets + len(summary),
                        group_length=len(group),
                    )
                )
                summary += group
        footer = Footer(
            summary_start=self.octets,
            summary_offset_start=self.octets + len(summary),
            summary_crc=0,
        )
        # The check covers the footer, too, up to the check itself.
        checked = bytes(summary + offsets) + octets_of(footer)[:-4]
        footer.summary_crc = crc32(checked)
        return bytes(summary + offsets) + octets_of(footer) + MAGIC


class _OpenChunk:
    """The records of a chunk that has not ended. begun_ns: when its first message came."""

    def __init__(self) -> None:
        self.records: list[bytes] = []
        self.octets = 0
        self._defined: set[bytes] = set()
        self.indexes: dict[int, list[tuple[int, int]]] = {}
        self.begun_ns: int | None = None
        self.first_ns = self.last_ns = 0

    def octets_with(self, definitions: tuple[bytes, ...]) -> int:
        """Its length with these schemas and channels, too."""
        new = (len(record) for record in definitions if record not in self._defined)
        return self.octets + sum(new)

    def define(self, definitions: tuple[bytes, ...]) -> None:
        for record in definitions:
            if record not in self._defined:
                self._defined.add(record)
                self._append(record)

    def add(self, channel_id: int, record: bytes, log_ns: int, now_ns: int) -> None:
        if self.begun_ns is None:
            self.begun_ns = now_ns
            self.first_ns = self.last_ns = log_ns
        self.first_ns, self.last_ns = min(self.first_ns, log_ns), max(self.last_ns, log_ns)
        self.indexes.setdefault(channel_id, []).append((log_ns, self.octets))
        self._append(record)

    def _append(self, record: bytes) -> None:
        self.records.append(record)
        self.octets += len(record)
