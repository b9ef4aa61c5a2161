"""Turns samples of a session's topics into the parts of a recording. A core.

A stream of pictures begins with a key picture in each part. That comes a little later than it was
asked for. Until it is there, the stream's units wait, and before a new part all streams' key
pictures are awaited. What was before them belongs to the part before.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from math import ceil
from typing import Final

from kontur_av.clock import NS_PER_S
from kontur_av.media import CaptureStamp
from kontur_av.streams.coded_unit import CodedUnit
from pipelines.media.joined_units import JoinedSequence, StreamUnit
from pipelines.recording.camera_coder import CameraCoder
from pipelines.recording.channels import RECORDER_LOSSES, Source, channels_of
from pipelines.recording.metadata import RecordingMetadata
from pipelines.recording.part_streams import ChannelCounts, PartStreams
from pipelines.recording.recorded_messages import ChannelLoss, RecordedEvent, RecorderLosses, pack
from pipelines.recording.recorder_metrics import RecordedChannel, RecorderMetrics
from pipelines.recording.session_messages import ChannelMessage, Figure, Instants, SessionMessages
from pipelines.session.recording_requests import PartLimits
from pipelines.session.session_metrics import SampleNumbers
from pipelines.session.topology.table import Topology
from telepresence.tmtc.pus.dictionary import Dictionary

#: Events come at most so late: the launcher looks for them once a second.
EVENTS_LATE_NS: Final = 3 * NS_PER_S
#: How often the losses are written, while they change.
_LOSSES_NS = NS_PER_S
#: Octets that may wait for a slow disk: minutes of a session.
MOST_WAITING_OCTETS: Final = 32 << 20
#: How long a new part is awaited by its key pictures.
TURN_NS: Final = NS_PER_S


@dataclass
class _Pictures:
    """A stream of pictures.

    begun: some of it was recorded. ahead: its messages for the part that is to be opened.
    """

    source: Source
    sequence: JoinedSequence = field(default_factory=lambda: JoinedSequence(waits=True))
    begun: bool = False
    ahead: list[ChannelMessage] = field(default_factory=list)


class Recorder:
    """One recording.

    While `wants_part` is True, open a new file, and report with `handle_opened`, or
    `parts.handle_fault`. Ask the writers of topics for key pictures by `poll_ask`.
    After `handle_end` take what is left.

    metadata: of the first part. dictionary: names what packets say. wall_offset_ns: wall time less
    the session's clock. parts: what is to be written.
    """

    def __init__(
        self,
        topology: Topology,
        metadata: RecordingMetadata,
        dictionary: Dictionary,
        *,
        wall_offset_ns: int,
        link_frames: bool = False,
        limits: PartLimits | None = None,
        most_waiting_octets: int = MOST_WAITING_OCTETS,
    ) -> None:
        self._metadata, self._offset_ns = metadata, wall_offset_ns
        self._limits, self._setup = limits or PartLimits(), topology.setup
        rows = channels_of(topology, link_frames=link_frames)
        self._numbers = {row.topic: row.number for row in rows}
        self._counts = ChannelCounts()
        self.parts = PartStreams((row.records() for row in rows), self._counts, most_waiting_octets)
        self._messages = SessionMessages(wall_offset_ns, dictionary)
        #: By channel of units.
        self._pictures: dict[str, _Pictures] = {}
        self._keys_late = 0
        #: When the key pictures of the next part were asked for.
        self._turn_ns: int | None = None
        self._coders: dict[str, CameraCoder] = {}
        self._coded: Counter[str] = Counter()
        #: Events that wait for earlier ones, with the instants at which they came.
        self._events_due: list[tuple[RecordedEvent, int]] = []
        self._sample_numbers = SampleNumbers()
        self._joined_ns = 0
        self._ended = False
        #: When the losses may be told next, how many were told, and how often.
        self._losses_ns = self._lost_told = self._own_number = 0

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
        unit = source.topic.unpack(octets) if source.topic.type is CodedUnit else None
        if unit is None or not unit.added:
            missed = self._sample_numbers.handle_sample(source.topic, stamp.sequence)
            for channel in source.channels:
                self._counts.missed[self._numbers[channel]] += missed
        if unit is not None:
            self._handle_unit(source, unit, stamp, at)
            return
        self._put(self._messages.of_sample(source, octets, stamp, at))
        for event in self._messages.touches(source, octets):
            self.handle_event(event, now_ns)

    def coder(self, source: Source) -> CameraCoder:
        whole = self._setup.recorded_cameras == "all"
        coder = (
            CameraCoder(ceil(self._setup.stream_of(source.name).fps)) if whole else CameraCoder()
        )
        return self._coders.setdefault(source.name, coder)

    def handle_camera(self, source: Source, unit: bytes, stamp: CaptureStamp, now_ns: int) -> None:
        """A picture of a camera was coded.

        Pictures between two coded ones are missed only if all cameras are recorded.
        """
        if self._setup.recorded_cameras == "all":
            missed = self._sample_numbers.handle_sample(source.topic, stamp.sequence)
            self._counts.missed[self._numbers[source.channels[0]]] += missed
        self._coded[source.name] += 1
        number = self._coded[source.name]
        self._put([self._messages.of_camera(source, unit, stamp, number, now_ns)])

    def handle_event(self, event: RecordedEvent, now_ns: int) -> None:
        """Take an event. It is written when earlier ones have come, so that all are in order."""
        self._events_due.append((event, now_ns))

    def _write_events(self, until_ns: int | None = None) -> None:
        due = self._events_due
        due.sort(key=lambda each: each[0].session_ns)
        while due and (until_ns is None or due[0][0].session_ns <= until_ns):
            self._put(self._messages.of_event(*due.pop(0)))

    def handle_metrics(self, metrics: Mapping[str, Figure], session_ns: int, now_ns: int) -> None:
        if self.parts.is_open:
            self._put([self._messages.of_metrics(metrics, session_ns, now_ns)])

    # Pictures

    def poll_ask(self, source: Source, now_ns: int) -> bool:
        """Return whether to ask a topic's writer for a key picture now, by `Reader.rejoin`."""
        pictures = self._pictures.get(source.channels[0])
        return pictures is not None and pictures.sequence.poll_ask(now_ns)

    def _handle_unit(
        self, source: Source, unit: CodedUnit, stamp: CaptureStamp, at: Instants
    ) -> None:
        pictures = self._pictures.get(source.channels[0])
        if pictures is None:
            pictures = self._pictures[source.channels[0]] = _Pictures(source)
        live, begin, before, _ = pictures.sequence.handle_unit(unit, stamp, at.published_ns)
        if begin and not pictures.begun:
            # The recording of this stream begins with the key picture.
            before = ()
        elif before and not begin:
            self._keys_late += 1
        passed = begin if live is None else [*begin, live]
        pictures.begun = pictures.begun or bool(before or passed)
        self._put(self._of_units(pictures, before, at.now_ns))
        messages = self._of_units(pictures, passed, at.now_ns)
        if self._turn_ns is not None and self.parts.is_open:
            pictures.ahead += messages
        else:
            self._put(messages)

    def _of_units(
        self, pictures: _Pictures, units: Iterable[StreamUnit], now_ns: int
    ) -> Iterator[ChannelMessage]:
        for each in units:
            yield from self._messages.of_unit(pictures.source, each, now_ns)

    def _put(self, messages: Iterable[ChannelMessage]) -> None:
        for message in messages:
            self.parts.put(
                self._numbers[message.channel],
                message.data,
                log_ns=message.log_ns,
                publish_ns=message.at.published_ns + self._offset_ns,
                sequence=message.sequence,
                now_ns=message.at.now_ns,
            )

    # Parts

    def wants_part(self, now_ns: int) -> bool:
        """Whether to open the file of a new part now. Ahead of one, key pictures are asked for."""
        parts = self.parts
        if self._ended or not parts.may_open(now_ns):
            return False
        if not parts.is_open:
            return True
        if now_ns - parts.begun_ns < self._limits.ns and parts.octets < self._limits.octets:
            return False
        if self._turn_ns is None:
            self._turn_ns = now_ns
            for pictures in self._pictures.values():
                pictures.sequence.waits = True
        late = now_ns - self._turn_ns >= TURN_NS
        return late or not any(each.sequence.holds for each in self._pictures.values())

    def handle_opened(self, part: int, now_ns: int) -> None:
        """The file of this part was opened. part: greater than all before."""
        wall_ns = now_ns + self._offset_ns
        metadata = replace(self._metadata, part=part, session_ns=now_ns, wall_ns=wall_ns)
        self.parts.handle_opened(part, metadata, now_ns)
        self._joined_ns = self._joined_ns or now_ns
        self._turn_ns = None
        for pictures in self._pictures.values():
            pictures.sequence.waits = pictures.sequence.waits or not pictures.ahead
            self._put(pictures.ahead)
            pictures.ahead = []
        self._messages.handle_fresh()
        for coder in self._coders.values():
            coder.handle_part()
        self._losses_ns = now_ns
        self._lost_told = 0

    def handle_time(self, now_ns: int) -> None:
        """Write the losses if they have changed. Call it at least once a second."""
        self._write_events(now_ns - EVENTS_LATE_NS)
        counts = self._counts
        if not self.parts.is_open or now_ns < self._losses_ns:
            return
        self._losses_ns = now_ns + _LOSSES_NS
        if counts.lost == self._lost_told:
            return
        self._lost_told = counts.lost
        losses = tuple(
            ChannelLoss(channel=topic, missed=counts.missed[number], dropped=counts.dropped[number])
            for topic, number in self._numbers.items()
            if counts.missed[number] or counts.dropped[number]
        )
        told = RecorderLosses(session_ns=now_ns, losses=losses)
        self._own_number += 1
        at, wall_ns = Instants(now_ns, now_ns), now_ns + self._offset_ns
        self._put([ChannelMessage(RECORDER_LOSSES, pack(told), wall_ns, self._own_number, at)])

    def handle_end(self, now_ns: int) -> None:
        """The recording ends: its last part is closed with a summary."""
        for pictures in self._pictures.values():
            # Their key pictures come no more.
            kept = pictures.sequence.take_kept()
            self._put([*pictures.ahead, *self._of_units(pictures, kept, now_ns)])
        self._losses_ns = now_ns
        self.handle_time(now_ns)
        self._write_events()
        self.parts.end(now_ns)
        self._ended = True

    def metrics(self, file: str | None) -> RecorderMetrics:
        """Return what was kept and lost so far. file: the newest."""
        counts, parts = self._counts, self.parts
        waiting = sum(
            pictures.sequence.kept_octets + sum(len(each.data) for each in pictures.ahead)
            for pictures in self._pictures.values()
        )
        return RecorderMetrics(
            parts=parts.count,
            octets=parts.written_octets,
            disk_faults=parts.faults,
            late_keys=self._keys_late,
            file=file,
            recording=file is not None,
            fault=parts.fault or None,
            waiting_octets=parts.waiting_octets + waiting,
            channels={
                topic: RecordedChannel(
                    kept=counts.kept[number],
                    missed=counts.missed[number],
                    dropped=counts.dropped[number],
                )
                for topic, number in self._numbers.items()
                if counts.kept[number] or counts.missed[number] or counts.dropped[number]
            },
        )
