"""Reads an MCAP file from its first octet to its last, however it was torn or damaged. A core.

Nothing is believed that its check does not confirm. Where a record cannot be believed, the search
goes on from the end of the last confirmed one, for the next chunk or metadata record whose check is
right. So a fault costs no more than the chunk in which it lies.

Files of other programs are read, too, as far as they are sound: uncompressed and without chunks, or
compressed by zstd or lz4.
"""

import re
import struct
from binascii import crc32
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import lru_cache, partial
from typing import Final, NamedTuple

from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, DataEnd, Footer, Header, Message, Metadata, Schema

from kontur_av.errors import ProtocolError
from kontur_av.sources.recorded_format import FORMAT, FORMAT_KEY, unpacked_chunk
from pipelines.recording import mcap_stream
from pipelines.recording.mcap_stream import McapStream
from pipelines.recording.metadata import (
    LIBRARY,
    METADATA,
    REPAIRED,
    RecordingMetadata,
    is_sealed,
    needs_seal,
    sealed,
)

#: A longer record is damage.
_MOST_RECORD_OCTETS = 1 << 40
_DATA_END_OCTETS = len(mcap_stream.octets_of(DataEnd(data_section_crc=0)))
_FOOTER_OCTETS = len(
    mcap_stream.octets_of(Footer(summary_start=0, summary_offset_start=0, summary_crc=0))
)
_KNOWN_RECORDS = 256
#: From this opcode on a record is some program's own.
_PRIVATE = 0x80

#: What a chunk or one of our metadata records looks like, for the search after damage.
_CANDIDATE: Final = re.compile(
    rb"\x06.{5}\0\0\0.{28}(?:\x04\0\0\0zstd|\x03\0\0\0lz4|\0\0\0\0)"
    rb"|\x0c.{6}\0\0.\0\0\0" + re.escape(METADATA.encode()),
    re.DOTALL,
)


class FoundMessage(NamedTuple):
    """A message with its channel and schema; schema: None if the channel has none."""

    schema: Schema | None
    channel: Channel
    message: Message

    @property
    def kind(self) -> str:
        """The name of its schema; "" without one."""
        return "" if self.schema is None else self.schema.name


@dataclass(slots=True)
class ScanMetrics:
    """What a scan found.

    octets: of the file. holes: places that could not be read, (first octet, octet behind).
    orphans: messages whose channel is not known. closed: the file has a right end: summary, footer.
    sound: closed, without a hole, and all checks are right.
    """

    octets: int
    chunks: int = 0
    messages: int = 0
    orphans: int = 0
    holes: list[tuple[int, int]] = field(default_factory=list)
    closed: bool = False
    sound: bool = False

    @property
    def unread_octets(self) -> int:
        return sum(end - begin for begin, end in self.holes)


class _Read(NamedTuple):
    """A record that was believed: what it yields, where it ends; checked: by a CRC of its own."""

    items: Sequence[FoundMessage | Metadata | Attachment]
    end: int
    checked: bool


class Scan:
    """One pass over the octets of a file. Iterate over `items` once; then look at the rest.

    header: None if it is damaged. schemas, channels: those of intact chunks, and of a file without
    chunks. ours: the file is a recording of this project.

    Raises ProtocolError for octets that do not begin as an MCAP file does.
    """

    def __init__(self, octets: memoryview) -> None:
        if bytes(octets[: len(mcap_stream.MAGIC)]) != mcap_stream.MAGIC:
            raise ProtocolError("it is not an MCAP file")
        self.metrics = ScanMetrics(octets=len(octets))
        self.header: Header | None = None
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.formats: set[str] = set()
        self._octets = octets
        #: Schemas and channels outside of chunks, which no check covers.
        self._loose_schemas: dict[int, Schema] = {}
        self._loose_channels: dict[int, Channel] = {}
        self._confirmed = len(mcap_stream.MAGIC)
        # Chunks repeat the same few records over and over.
        self._read_schema = lru_cache(_KNOWN_RECORDS)(partial(mcap_stream.parse_record, Schema))
        self._read_channel = lru_cache(_KNOWN_RECORDS)(partial(mcap_stream.parse_record, Channel))

    @property
    def library(self) -> str:
        """Who wrote the file; "" if that is not known."""
        return "" if self.header is None else self.header.library

    @property
    def ours(self) -> bool:
        """Whether the file is a recording of this project."""
        return bool(self.formats)

    def items(self) -> Iterator[FoundMessage | Metadata | Attachment]:
        """Yield messages, metadata and attachments in the order of the file."""
        at, size = len(mcap_stream.MAGIC), len(self._octets)
        while at < size:
            read = self._record(at)
            if read is None:
                found = self._next_confirmed()
                begin = at if found is None or at < found else self._confirmed
                self.metrics.holes.append((begin, size if found is None else found))
                if found is None:
                    break
                at = found
                continue
            yield from read.items
            at = read.end
            if read.checked:
                self._confirmed = at
            if self.metrics.closed:
                break
        metrics = self.metrics
        metrics.sound = metrics.closed and metrics.sound and not metrics.holes

    def _record(self, at: int) -> _Read | None:
        """The record at this octet, or None if it is not to be believed."""
        head = self._head(at)
        if head is None:
            return None
        opcode, begin, end = head
        if opcode == Opcode.CHUNK:
            messages = self._chunk(begin, end)
            return None if messages is None else _Read(messages, end, True)
        if opcode == Opcode.METADATA:
            return self._metadata(at, begin, end)
        if opcode == Opcode.ATTACHMENT:
            return self._attachment(begin, end)
        if opcode == Opcode.DATA_END:
            closed = end == at + _DATA_END_OCTETS and self._is_closed(at)
            return _Read([], len(self._octets), True) if closed else None
        if not self._is_followed(end):
            return None
        if opcode == Opcode.MESSAGE:
            return self._loose_message(begin, end)
        if opcode == Opcode.MESSAGE_INDEX:
            (length,) = mcap_stream.LENGTH_4.unpack_from(self._octets, begin + 2)
            return _Read([], end, False) if length == end - begin - 6 else None
        if opcode == Opcode.HEADER and self.header is None:
            self.header = self._read(Header, begin, end)
            return None if self.header is None else _Read([], end, False)
        if opcode == Opcode.SCHEMA and (schema := self._read(Schema, begin, end)):
            self._loose_schemas[schema.id] = schema
            return _Read([], end, False)
        if opcode == Opcode.CHANNEL and (channel := self._read(Channel, begin, end)):
            self._loose_channels[channel.id] = channel
            return _Read([], end, False)
        if opcode >= _PRIVATE and not self.ours:
            return _Read([], end, False)
        return None

    def _head(self, at: int) -> tuple[int, int, int] | None:
        """Opcode, first octet and end of the content of a record that is there as a whole."""
        if at + mcap_stream.HEAD.size > len(self._octets):
            return None
        opcode, length = mcap_stream.HEAD.unpack_from(self._octets, at)
        begin = at + mcap_stream.HEAD.size
        if length > len(self._octets) - begin:
            return None
        # Shorter than any content that is looked at before it is read as a whole.
        if opcode in (Opcode.MESSAGE_INDEX, Opcode.ATTACHMENT) and length < 6:
            return None
        return opcode, begin, begin + length

    def _is_followed(self, end: int) -> bool:
        """Whether a record without a check may end here: another one begins, or the file ends."""
        if end + mcap_stream.HEAD.size > len(self._octets):
            return True
        opcode, length = mcap_stream.HEAD.unpack_from(self._octets, end)
        known = Opcode.HEADER <= opcode <= Opcode.DATA_END or opcode >= _PRIVATE
        return bool(known and length < _MOST_RECORD_OCTETS)

    def _read(self, kind: type[mcap_stream.Kind], begin: int, end: int) -> mcap_stream.Kind | None:
        return mcap_stream.parse_record(kind, bytes(self._octets[begin:end]))

    def _metadata(self, at: int, begin: int, end: int) -> _Read | None:
        record = self._read(Metadata, begin, end)
        if record is None:
            return None
        checked = needs_seal(record.name, record.metadata)
        if checked and not is_sealed(record.name, record.metadata):
            return None
        # A user's own has no check.
        if not checked and not self._is_followed(end):
            return None
        if record.name == METADATA and (told := record.metadata.get("format")):
            self.formats.add(told)
        # The check does not cover the length that stands before the record.
        return _Read([record], at + len(mcap_stream.octets_of(record)) if checked else end, checked)

    def _attachment(self, begin: int, end: int) -> _Read | None:
        """An attachment is a user's. Its check may be 0: none."""
        (told,) = mcap_stream.LENGTH_4.unpack_from(self._octets, end - 4)
        checked = told == crc32(self._octets[begin : end - 4])
        if not checked and (told or not self._is_followed(end)):
            return None
        record = self._read(Attachment, begin, end)
        return None if record is None else _Read([record], end, checked)

    def _loose_message(self, begin: int, end: int) -> _Read | None:
        """A message outside of chunks: only in a file that another program wrote without chunks."""
        if self.metrics.chunks or end - begin < mcap_stream.MESSAGE.size:
            return None
        message = self._message(begin, end, self._octets)
        # A copy of ours tells its channels first. Otherwise it is a damaged chunk.
        if self.ours and message.channel_id not in self._loose_channels:
            return None
        found = self._with_channel(message, self._loose_channels, self._loose_schemas)
        self.channels, self.schemas = self._loose_channels, self._loose_schemas
        return _Read([] if found is None else [found], end, False)

    def _message(self, begin: int, end: int, octets: memoryview | bytes) -> Message:
        channel_id, sequence, log_ns, publish_ns = mcap_stream.MESSAGE.unpack_from(octets, begin)
        return Message(
            channel_id=channel_id,
            sequence=sequence,
            log_time=log_ns,
            publish_time=publish_ns,
            data=bytes(octets[begin + mcap_stream.MESSAGE.size : end]),
        )

    def _with_channel(
        self, message: Message, channels: dict[int, Channel], schemas: dict[int, Schema]
    ) -> FoundMessage | None:
        channel = channels.get(message.channel_id) or self._loose_channels.get(message.channel_id)
        schema = None
        if channel is not None and channel.schema_id:
            schema = schemas.get(channel.schema_id) or self._loose_schemas.get(channel.schema_id)
        if channel is None or (channel.schema_id and schema is None):
            self.metrics.orphans += 1
            return None
        self.metrics.messages += 1
        return FoundMessage(schema, channel, message)

    def _chunk(self, begin: int, end: int) -> list[FoundMessage] | None:
        """The messages of a chunk, or None if it is damaged."""
        parsed = self._parsed_chunk(begin, end)
        if parsed is None:
            return None
        self.schemas, self.channels, messages = parsed
        self.formats |= {
            channel.metadata[FORMAT_KEY]
            for channel in self.channels.values()
            if FORMAT_KEY in channel.metadata
        }
        self.metrics.chunks += 1
        found = (self._with_channel(each, self.channels, self.schemas) for each in messages)
        return [message for message in found if message is not None]

    def _parsed_chunk(
        self, begin: int, end: int
    ) -> tuple[dict[int, Schema], dict[int, Channel], list[Message]] | None:
        """All schemas and channels known with this chunk, and its messages; None if damaged."""
        plain = self._unpacked(begin, end)
        if plain is None:
            return None
        schemas, channels = dict(self.schemas), dict(self.channels)
        messages: list[Message] = []
        at = 0
        while at < len(plain):
            if at + mcap_stream.HEAD.size > len(plain):
                return None
            opcode, length = mcap_stream.HEAD.unpack_from(plain, at)
            first = at + mcap_stream.HEAD.size
            at = first + length
            if at > len(plain):
                return None
            if opcode == Opcode.MESSAGE:
                if length < mcap_stream.MESSAGE.size:
                    return None
                messages.append(self._message(first, at, plain))
            elif opcode == Opcode.SCHEMA:
                schema = self._read_schema(plain[first:at])
                if schema is None or schemas.setdefault(schema.id, schema) != schema:
                    return None
            elif opcode == Opcode.CHANNEL:
                channel = self._read_channel(plain[first:at])
                if channel is None or channels.setdefault(channel.id, channel) != channel:
                    return None
        return schemas, channels, messages

    def _unpacked(self, begin: int, end: int) -> bytes | None:
        """What is in a chunk, or None if its check is wrong."""
        octets = self._octets
        try:
            _, _, size, crc = mcap_stream.CHUNK.unpack_from(octets, begin)
            at = begin + mcap_stream.CHUNK.size
            (length,) = mcap_stream.LENGTH_4.unpack_from(octets, at)
            at += mcap_stream.LENGTH_4.size
            compression = bytes(octets[at : at + min(length, 8)]).decode("ascii", "replace")
            at += length
            (length,) = mcap_stream.LENGTH_8.unpack_from(octets, at)
            at += mcap_stream.LENGTH_8.size
        except (struct.error, OverflowError):
            return None
        if at + length != end:
            return None
        plain = unpacked_chunk(compression, octets[at:end], size)
        return None if plain is None or (crc and crc32(plain) != crc) else plain

    def _next_confirmed(self) -> int | None:
        """Where the next chunk or metadata record begins whose check is right."""
        at = self._confirmed
        while (match := _CANDIDATE.search(self._octets, at)) is not None:
            at = match.start()
            head = self._head(at)
            if head is not None and self._is_confirmed(*head):
                return at
            at += 1
        return None

    def _is_confirmed(self, opcode: int, begin: int, end: int) -> bool:
        if opcode == Opcode.CHUNK:
            return self._parsed_chunk(begin, end) is not None
        record = self._read(Metadata, begin, end)
        return record is not None and is_sealed(record.name, record.metadata)

    def _is_closed(self, at: int) -> bool:
        """Whether the data end at this octet, and after it comes a right end of the file."""
        octets, size = self._octets, len(self._octets)
        begin = at + _DATA_END_OCTETS
        footer_at = size - len(mcap_stream.MAGIC) - _FOOTER_OCTETS
        if footer_at < begin or bytes(octets[-len(mcap_stream.MAGIC) :]) != mcap_stream.MAGIC:
            return False
        data_end = self._read(DataEnd, at + mcap_stream.HEAD.size, begin)
        head = self._head(footer_at)
        if data_end is None or head is None or head[0] != Opcode.FOOTER:
            return False
        footer = self._read(Footer, head[1], head[2])
        if footer is None or footer.summary_start not in (0, begin):
            return False
        if footer.summary_crc and footer.summary_crc != crc32(
            octets[begin : size - len(mcap_stream.MAGIC) - mcap_stream.LENGTH_4.size]
        ):
            return False
        self.metrics.closed = True
        crc = data_end.data_section_crc
        self.metrics.sound = not crc or crc == crc32(octets[:at])
        return True


def first_capabilities(octets: memoryview) -> RecordingMetadata | None:
    """Return the facts at the beginning of a recording, or None; ProtocolError as `Scan`."""
    for item in Scan(octets).items():
        if isinstance(item, FoundMessage):
            return None
        if isinstance(item, Metadata) and item.name == METADATA:
            return RecordingMetadata.of(item.metadata)
    return None


class Recovery:
    """What can be read of a recording, as a file that any MCAP reader opens.

    metrics: what the scan of the torn file found. If they are `sound`, there is nothing to fix.

    Raises ProtocolError for octets that are not an MCAP file, and as `refuse_foreign`.
    """

    def __init__(self, octets: memoryview) -> None:
        self._octets = octets
        scan = Scan(octets)
        for _ in scan.items():
            pass
        check_format(scan)
        refuse_foreign(scan)
        self.metrics = scan.metrics

    def pieces(self) -> Iterator[bytes]:
        """Yield the octets of the whole file, in order."""
        stream = McapStream(library=LIBRARY)
        scan = Scan(self._octets)
        declared: set[int] = set()
        for item in scan.items():
            if isinstance(item, Metadata):
                stream.handle_metadata(item.name, item.metadata)
            elif isinstance(item, Attachment):
                stream.handle_attachment(item)
            else:
                schema, channel, message = item
                if channel.id not in declared:
                    declared.add(channel.id)
                    stream.handle_channel(schema, channel)
                stream.handle_message(
                    channel.id,
                    message.data,
                    log_ns=message.log_time,
                    publish_ns=message.publish_time,
                    sequence=message.sequence,
                    now_ns=0,
                )
            yield from _waiting(stream)
        # Those that have no message say what was to be recorded.
        for channel in scan.channels.values():
            if channel.id not in declared:
                stream.handle_channel(scan.schemas.get(channel.schema_id), channel)
        names = ("octets", "unread_octets", "holes", "messages")
        told = {name: getattr(self.metrics, name) for name in names}
        told["holes"] = len(self.metrics.holes)
        items = sealed(REPAIRED, {name: str(value) for name, value in told.items()})
        stream.handle_metadata(REPAIRED, items)
        stream.handle_end()
        yield from _waiting(stream)


def refuse_foreign(scan: Scan) -> None:
    """Raise ProtocolError if a scan that is done found no recording of ours, or nothing of it."""
    if scan.ours:
        return
    if scan.metrics.messages and not scan.library.startswith(LIBRARY.split()[0]):
        raise ProtocolError(
            f"it was written by {scan.library or 'an unknown program'}, not by kontur-av: "
            "`kontur-av info` shows what is in it"
        )
    raise ProtocolError("nothing in it can be read any more")


def check_format(scan: Scan) -> None:
    """Raise ProtocolError if a scan that is done found a recording of a newer format."""
    newer = sorted(text for text in scan.formats if not text.isdecimal() or int(text) > FORMAT)
    if newer:
        raise ProtocolError(
            f"it has format {newer[-1]}, and this kontur-av reads up to format {FORMAT}: "
            "install a newer one"
        )


def _waiting(stream: McapStream) -> Iterator[bytes]:
    while (octets := stream.poll_transmit(0)) is not None:
        yield octets
