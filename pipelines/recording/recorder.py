"""Turns samples of a session's topics into the parts of a recording, and counts losses. A core.

Every message that came is either in a part, or counted as lost, by channel:

- missed: it was gone from its topic before it was read, by the sequence numbers of the topic;
- dropped: it was read, but the disk was too slow or full.

Where a part begins in the middle of a stream, a key picture may have to be made. Until it is there,
the stream's messages are held, and written behind it in their order.
"""

from collections import Counter, deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple

from kontur_av.clock import NS_PER_S
from kontur_av.codecs.black_key import black_key
from kontur_av.media import CaptureStamp
from kontur_av.streams.coded_unit import CodedUnit
from pipelines.recording.channels import RECORDER_LOSSES, Content, Source, channels_of
from pipelines.recording.mcap_stream import McapStream, Piece
from pipelines.recording.metadata import LIBRARY, METADATA, RecordingMetadata
from pipelines.recording.own_pictures import (
    KEY_TIMEOUT_NS,
    MOST_HELD_OCTETS,
    Begun,
    CameraCoder,
    KeyPictureWanted,
    StreamStart,
)
from pipelines.recording.recorded_messages import ChannelLoss, RecordedEvent, RecorderLosses, pack
from pipelines.recording.recorder_metrics import RecordedChannel, RecorderMetrics
from pipelines.recording.session_messages import ChannelMessage, Figure, Instants, SessionMessages
from pipelines.session.recording_requests import PartLimits
from pipelines.session.session_metrics import SampleNumbers
from pipelines.session.topology.table import Topology

#: After a fault of the disk, a new part is tried this often.
RETRY_NS: Final = 2 * NS_PER_S
#: Events come at most so late: the launcher looks for them once a second.
EVENTS_LATE_NS: Final = 3 * NS_PER_S
#: How often the losses are written, while they change.
_LOSSES_NS = NS_PER_S
#: Octets that may wait for a slow disk: minutes of a session.
MOST_WAITING_OCTETS: Final = 32 << 20


class PartPiece(NamedTuple):
    """Octets for the file of a part, with so many messages. last: close the file after them."""

    part: int
    octets: bytes
    messages: int
    last: bool


@dataclass(frozen=True, kw_only=True)
class _Held:
    """Messages of a stream that wait for the key picture ahead of them.

    unit, stamp, at: of the unit behind the key picture.
    """

    wanted: KeyPictureWanted
    source: Source
    unit: CodedUnit
    stamp: CaptureStamp
    at: Instants
    messages: list[ChannelMessage] = field(default_factory=list)

    @property
    def octets(self) -> int:
        return sum(len(each.data) for each in self.messages)


class Recorder:
    """One recording.

    While `wants_part` is True, open a new file, and report with `handle_opened` or `handle_fault`.
    Write what `poll_transmit` returns, each into the file of its part, and report each piece in
    order with `handle_written`, or with `handle_fault` that no more of this part can be written.
    Make the key pictures that `next_event` returns, and hand them to `handle_key_picture`.
    After `handle_end` take what is left.

    metadata: of the first part. wall_offset_ns: wall time less the session's clock.
    """

    def __init__(
        self,
        topology: Topology,
        metadata: RecordingMetadata,
        *,
        wall_offset_ns: int,
        link_frames: bool = False,
        limits: PartLimits | None = None,
        most_waiting_octets: int = MOST_WAITING_OCTETS,
    ) -> None:
        self._metadata, self._offset_ns = metadata, wall_offset_ns
        self._limits = limits or PartLimits()
        self._most_waiting_octets = most_waiting_octets
        rows = channels_of(topology, link_frames=link_frames)
        self._records = [row.records() for row in rows]
        self._numbers = {row.topic: row.number for row in rows}
        self._topics = {row.number: row.topic for row in rows}
        self._told = SessionMessages(wall_offset_ns)
        self._starts: dict[str, StreamStart] = {}
        #: Channels of units that this part has begun.
        self._begun: set[str] = set()
        #: By channel of units: what waits for a key picture.
        self._held: dict[str, _Held] = {}
        self._wanted: deque[KeyPictureWanted] = deque()
        self._keys_wanted = self._keys_late = 0
        self._coders: dict[str, CameraCoder] = {}
        self._setup = topology.setup
        self._coded: Counter[str] = Counter()
        #: Events that wait for earlier ones, with the instants at which they came.
        self._events_due: list[tuple[RecordedEvent, int]] = []
        self._sample_numbers = SampleNumbers()
        self._stream: McapStream | None = None
        self._part = 0
        self._begun_ns = self._joined_ns = 0
        self._ended = False
        self._retry_ns: int | None = None
        #: Pieces of parts that have ended, and the counts of those that are being written.
        self._left: deque[tuple[int, Piece, bool]] = deque()
        self._writing: deque[tuple[int, Mapping[int, int], int]] = deque()
        self._kept: Counter[int] = Counter()
        self._missed: Counter[int] = Counter()
        self._dropped: Counter[int] = Counter()
        self._told_losses = 0
        self._losses_ns = 0
        self._own_number = 0
        self._parts = self._octets = self._faults = 0
        #: Why nothing is written at present; "" if all is well.
        self.fault = ""

    # Samples

    def handle_sample(
        self,
        source: Source,
        octets: bytes,
        stamp: CaptureStamp,
        now_ns: int,
        *,
        published_ns: int | None = None,
    ) -> None:
        """A sample of a topic, other than a camera's. published_ns: when, if not just now."""
        at = Instants(now_ns if published_ns is None else published_ns, now_ns)
        if source.topic not in self._sample_numbers and at.published_ns < self._joined_ns:
            # A topic gives a new reader its newest sample. That may be from the recording before:
            # those since then were counted, and not published.
            return
        missed = self._sample_numbers.handle_sample(source.topic, stamp.sequence)
        for channel in source.channels:
            self._missed[self._numbers[channel]] += missed
        if source.content is Content.UNIT:
            self._handle_unit(source, CodedUnit.unpack(octets), stamp, at)
            return
        self._put(self._told.of_sample(source, octets, stamp, at))
        for event in self._told.touches(source, octets):
            self.handle_event(event, now_ns)

    def coder(self, source: Source) -> CameraCoder:
        whole = self._setup.recorded_cameras == "all"
        coder = CameraCoder(self._setup.stream_of(source.name).fps) if whole else CameraCoder()
        return self._coders.setdefault(source.name, coder)

    def handle_camera(self, source: Source, unit: bytes, stamp: CaptureStamp, now_ns: int) -> None:
        """A picture of a camera was coded.

        Pictures between two coded ones are missed only if all cameras are recorded.
        """
        if self._setup.recorded_cameras == "all":
            missed = self._sample_numbers.handle_sample(source.topic, stamp.sequence)
            self._missed[self._numbers[source.channels[0]]] += missed
        self._coded[source.name] += 1
        number = self._coded[source.name]
        self._put([self._told.of_camera(source, unit, stamp, number, now_ns)])

    def handle_event(self, event: RecordedEvent, now_ns: int) -> None:
        """Take an event. It is written when earlier ones have come, so that all are in order."""
        self._events_due.append((event, now_ns))

    def _write_events(self, until_ns: int | None = None) -> None:
        due = self._events_due
        due.sort(key=lambda each: each[0].session_ns)
        while due and (until_ns is None or due[0][0].session_ns <= until_ns):
            self._put(self._told.of_event(*due.pop(0)))

    def handle_metrics(self, metrics: Mapping[str, Figure], session_ns: int, now_ns: int) -> None:
        if self._stream is not None:
            self._put([self._told.of_metrics(metrics, session_ns, now_ns)])

    def _handle_unit(
        self, source: Source, unit: CodedUnit, stamp: CaptureStamp, at: Instants
    ) -> None:
        channel = source.channels[0]
        start = self._starts.setdefault(channel, StreamStart())
        begun = start.handle_unit(unit, stamp, at.now_ns, begins=channel not in self._begun)
        if begun is not None:
            self._begun.add(channel)
        key, data = begun or Begun(None, unit.data)
        if key is not None and self._stream is not None:
            self._keys_wanted += 1
            units = key if isinstance(key, tuple) else ()
            ahead = _Held(
                wanted=KeyPictureWanted(self._keys_wanted, units, unit.width, unit.height),
                source=source,
                unit=unit,
                stamp=stamp,
                at=at,
            )
            if isinstance(key, bytes):
                self._release(ahead, key)
            else:
                self._held[channel] = ahead
                self._wanted.append(ahead.wanted)
        messages = self._told.of_unit(source, unit, data, stamp, at)
        if (held := self._held.get(channel)) is None:
            self._put(messages)
            return
        held.messages.extend(messages)
        if held.octets > MOST_HELD_OCTETS:
            self._give_up(held)

    def next_event(self) -> KeyPictureWanted | None:
        return self._wanted.popleft() if self._wanted else None

    def handle_key_picture(self, number: int, key: bytes | None) -> None:
        """The key picture of this number is there; one that comes too late is left out.

        key: None if it could not be made; then a black one takes its place.
        """
        for held in list(self._held.values()):
            if held.wanted.number == number:
                del self._held[held.source.channels[0]]
                self._release(held, key or black_key(held.wanted.width, held.wanted.height))

    def _give_up(self, held: _Held) -> None:
        """Write what is held behind a black key picture, because its own comes too late."""
        self._keys_late += 1
        self.handle_key_picture(held.wanted.number, None)

    def _release(self, held: _Held, key: bytes) -> None:
        self._put(self._told.of_key(held.source, held.unit, key, held.stamp, held.at))
        self._put(held.messages)

    def _put(self, messages: Iterable[ChannelMessage]) -> None:
        for message in messages:
            number, at = self._numbers[message.channel], message.at
            taken = self._stream is not None and self._stream.handle_message(
                number,
                message.data,
                log_ns=max(0, message.log_ns),
                publish_ns=at.published_ns + self._offset_ns,
                sequence=message.sequence,
                now_ns=at.now_ns,
            )
            self._dropped[number] += not taken

    # Files

    def wants_part(self, now_ns: int) -> bool:
        """Whether to open the file of a new part now."""
        if self._ended or (self._retry_ns is not None and now_ns < self._retry_ns):
            return False
        if self._stream is None:
            return True
        return (
            now_ns - self._begun_ns >= self._limits.ns or self._stream.octets >= self._limits.octets
        )

    def handle_opened(self, part: int, now_ns: int) -> None:
        """The file of this part was opened. part: greater than all before."""
        self._end_stream(now_ns)
        self._retry_ns = None
        self._stream = stream = McapStream(
            library=LIBRARY, most_waiting_octets=self._most_waiting_octets
        )
        self._part, self._begun_ns = part, now_ns
        self._joined_ns = self._joined_ns or now_ns
        self._parts += 1
        metadata = replace(
            self._metadata, part=part, session_ns=now_ns, wall_ns=now_ns + self._offset_ns
        )
        stream.handle_metadata(METADATA, metadata.items())
        for schema, channel in self._records:
            stream.handle_channel(schema, channel)
        self._begun.clear()
        self._told.handle_fresh()
        for coder in self._coders.values():
            coder.handle_part()
        self._losses_ns = now_ns
        self._told_losses = 0

    def handle_fault(self, part: int | None, why: str, now_ns: int) -> None:
        """A file cannot be opened, or no more of a part be written.

        part: the part whose file failed; None: a new file could not be opened. why: in words.
        """
        self._faults += 1
        self.fault = why
        self._retry_ns = now_ns + RETRY_NS
        if part is None:
            return
        self._drop_unwritten(part)
        if part == self._part and self._stream is not None:
            stream, self._stream = self._stream, None
            for held in self._held.values():
                self._dropped.update(self._numbers[each.channel] for each in held.messages)
            self._held.clear()
            stream.handle_end()
            while (unwritten := stream.poll_piece(now_ns)) is not None:
                self._dropped.update(unwritten.messages)

    def handle_written(self) -> None:
        """The oldest piece that was not reported yet is in its file."""
        _, messages, octets = self._writing.popleft()
        self._kept.update(messages)
        self._octets += octets
        self.fault = "" if self._stream is not None else self.fault

    def handle_abandoned(self) -> None:
        """What was not written until now never will be."""
        for part in {each[0] for each in (*self._writing, *self._left)}:
            self._drop_unwritten(part)

    def _drop_unwritten(self, part: int) -> None:
        """Drop the pieces of a part that wait, and those that are being written."""
        for one, messages, _ in self._writing:
            self._dropped.update(messages if one == part else ())
        for one, piece, _ in self._left:
            self._dropped.update(piece.messages if one == part else ())
        self._writing = deque(each for each in self._writing if each[0] != part)
        self._left = deque(each for each in self._left if each[0] != part)

    def handle_time(self, now_ns: int) -> None:
        """Write the losses if they have changed. Call it at least once a second."""
        for held in list(self._held.values()):
            if now_ns - held.at.now_ns >= KEY_TIMEOUT_NS:
                self._give_up(held)
        self._write_events(now_ns - EVENTS_LATE_NS)
        if self._stream is None or now_ns < self._losses_ns:
            return
        self._losses_ns = now_ns + _LOSSES_NS
        lost = self._missed.total() + self._dropped.total()
        if lost == self._told_losses:
            return
        self._told_losses = lost
        told = RecorderLosses(
            session_ns=now_ns,
            losses=tuple(
                ChannelLoss(
                    channel=self._topics[number],
                    missed=self._missed[number],
                    dropped=self._dropped[number],
                )
                for number in sorted({*(+self._missed), *(+self._dropped)})
            ),
        )
        self._own_number += 1
        at = Instants(now_ns, now_ns)
        wall_ns = now_ns + self._offset_ns
        self._put([ChannelMessage(RECORDER_LOSSES, pack(told), wall_ns, self._own_number, at)])

    def handle_end(self, now_ns: int) -> None:
        """The recording ends: its last part is closed with a summary."""
        self._losses_ns = now_ns
        self.handle_time(now_ns)
        self._write_events()
        self._end_stream(now_ns)
        self._ended = True

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

    def _end_stream(self, now_ns: int) -> None:
        for held in list(self._held.values()):
            self._give_up(held)
        stream, self._stream = self._stream, None
        if stream is None:
            return
        stream.handle_end()
        pieces = []
        while (piece := stream.poll_piece(now_ns)) is not None:
            pieces.append(piece)
        self._left += ((self._part, each, each is pieces[-1]) for each in pieces)

    # Figures

    def metrics(self, file: str | None) -> RecorderMetrics:
        """Return what was kept and lost so far. file: the newest."""
        waiting = 0 if self._stream is None else self._stream.waiting_octets
        waiting += sum(held.octets for held in self._held.values())
        return RecorderMetrics(
            parts=self._parts,
            octets=self._octets,
            disk_faults=self._faults,
            late_keys=self._keys_late,
            file=file,
            recording=file is not None,
            fault=self.fault or None,
            waiting_octets=waiting,
            channels={
                self._topics[number]: RecordedChannel(
                    kept=self._kept[number],
                    missed=self._missed[number],
                    dropped=self._dropped[number],
                )
                for number in sorted({*(+self._kept), *(+self._missed), *(+self._dropped)})
            },
        )
