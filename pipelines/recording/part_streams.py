"""The parts of a recording as octets for their files, and what became of each message. A core.

Every message that came is either in a part, or counted as lost, by number of its channel:

- missed: it was gone from its topic before it was read, by the sequence numbers of the topic;
- dropped: it was read, but the disk was too slow or full.
"""

from collections import Counter, deque
from collections.abc import Iterable, Mapping
from typing import Final, NamedTuple

from mcap.records import Channel, Schema

from kontur_av.clock import NS_PER_S
from pipelines.recording.mcap_stream import McapStream, Piece
from pipelines.recording.metadata import LIBRARY, METADATA, RecordingMetadata

#: After a fault of the disk, a new part is tried this often.
RETRY_NS: Final = 2 * NS_PER_S


class PartPiece(NamedTuple):
    """Octets for the file of a part, with so many messages. last: close the file after them."""

    part: int
    octets: bytes
    messages: int
    last: bool


class ChannelCounts:
    """What became of messages, by number of the channel."""

    def __init__(self) -> None:
        self.kept: Counter[int] = Counter()
        self.missed: Counter[int] = Counter()
        self.dropped: Counter[int] = Counter()

    @property
    def lost(self) -> int:
        return self.missed.total() + self.dropped.total()


class PartStreams:
    """Write what `poll_transmit` returns, each into the file of its part.

    Report each piece in order with `handle_written`, or with `handle_fault` that no more of this
    part can be written.

    records: schema and channel of each channel.
    """

    def __init__(
        self, records: Iterable[tuple[Schema, Channel]], counts: ChannelCounts, most_waiting: int
    ) -> None:
        self._records, self._counts = list(records), counts
        self._most_waiting_octets = most_waiting
        self._stream: McapStream | None = None
        self._part = 0
        self._retry_ns: int | None = None
        #: Pieces of parts that have ended, and the counts of those that are being written.
        self._left: deque[tuple[int, Piece, bool]] = deque()
        self._writing: deque[tuple[int, Mapping[int, int], int]] = deque()
        self.begun_ns = self.count = self.written_octets = self.faults = 0
        #: Why nothing is written at present; "" if all is well.
        self.fault = ""

    @property
    def is_open(self) -> bool:
        return self._stream is not None

    @property
    def octets(self) -> int:
        """Of the present part."""
        return 0 if self._stream is None else self._stream.octets

    @property
    def waiting_octets(self) -> int:
        return 0 if self._stream is None else self._stream.waiting_octets

    def may_open(self, now_ns: int) -> bool:
        """Whether the newest fault of the disk is long ago."""
        return self._retry_ns is None or now_ns >= self._retry_ns

    def handle_opened(self, part: int, metadata: RecordingMetadata, now_ns: int) -> None:
        """The file of this part was opened. part: greater than all before."""
        self.end(now_ns)
        self._retry_ns = None
        self._part, self.begun_ns = part, now_ns
        self.count += 1
        self._stream = McapStream(library=LIBRARY, most_waiting_octets=self._most_waiting_octets)
        self._stream.handle_metadata(METADATA, metadata.items())
        for schema, channel in self._records:
            self._stream.handle_channel(schema, channel)

    def put(
        self, number: int, data: bytes, *, log_ns: int, publish_ns: int, sequence: int, now_ns: int
    ) -> None:
        """Take a message of the channel `number`, or count it as dropped."""
        taken = self._stream is not None and self._stream.handle_message(
            number,
            data,
            log_ns=max(0, log_ns),
            publish_ns=publish_ns,
            sequence=sequence,
            now_ns=now_ns,
        )
        self._counts.dropped[number] += not taken

    def handle_fault(self, part: int | None, why: str, now_ns: int) -> None:
        """A file cannot be opened, or no more of a part be written.

        part: the part whose file failed; None: a new file could not be opened. why: in words.
        """
        self.faults += 1
        self.fault = why
        self._retry_ns = now_ns + RETRY_NS
        if part is not None and part == self._part:
            self.end(now_ns)
        if part is not None:
            self._drop_unwritten(part)

    def handle_written(self) -> None:
        """The oldest piece that was not reported yet is in its file."""
        _, messages, octets = self._writing.popleft()
        self._counts.kept.update(messages)
        self.written_octets += octets
        self.fault = "" if self.is_open else self.fault

    def handle_abandoned(self) -> None:
        """What was not written until now never will be."""
        for part in {each[0] for each in (*self._writing, *self._left)}:
            self._drop_unwritten(part)

    def end(self, now_ns: int) -> None:
        """End the present part with a summary."""
        stream, self._stream = self._stream, None
        if stream is None:
            return
        stream.handle_end()
        pieces = []
        while (piece := stream.poll_piece(now_ns)) is not None:
            pieces.append(piece)
        self._left += ((self._part, each, each is pieces[-1]) for each in pieces)

    def poll_transmit(self, now_ns: int) -> PartPiece | None:
        """Return the next octets of a file, or None."""
        if self._left:
            part, piece, last = self._left.popleft()
        elif self._stream is not None and (found := self._stream.poll_piece(now_ns)) is not None:
            part, piece, last = self._part, found, False
        else:
            return None
        self._writing.append((part, piece.messages, len(piece.octets)))
        return PartPiece(part, piece.octets, sum(piece.messages.values()), last)

    def _drop_unwritten(self, part: int) -> None:
        """Drop the pieces of a part that wait, and those that are being written."""
        for number, messages, _ in self._writing:
            self._counts.dropped.update(messages if number == part else ())
        for number, piece, _ in self._left:
            self._counts.dropped.update(piece.messages if number == part else ())
        self._writing = deque(each for each in self._writing if each[0] != part)
        self._left = deque(each for each in self._left if each[0] != part)
