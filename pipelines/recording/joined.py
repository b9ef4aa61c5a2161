"""The parts of a recording as one: messages in their order, on the session's clock. A core."""

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import NamedTuple

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ProtocolError
from pipelines.recording.inventory import Inventory, take_inventory
from pipelines.recording.metadata import RecordingMetadata
from pipelines.recording.recorded_messages import (
    EVENT,
    HAPTIC_SAMPLES,
    RecordedEvent,
    unpack,
    unpack_haptics,
)
from pipelines.recording.scan import FoundMessage, Scan, refuse_foreign

#: A recorder writes messages within some seconds. What is further away has a wrong instant.
FAR_NS = 60 * NS_PER_S
#: How many messages on each side say what is right.
_AROUND = 32
#: A longer pause at the begin or the end is a wrong instant.
_LONGEST_NS = 30 * 3600 * NS_PER_S
#: The latest instant that tables hold.
_LATEST_NS = (1 << 63) - 1


class JoinedMessage(NamedTuple):
    """A message of a recording.

    session_ns: its `log_time` on the session's clock. published_ns: its `publish_time`, likewise.
    part: counts the parts that were joined, from 0. moved: the instants are not those of the file,
    which were far from those around them.
    """

    topic: str
    schema: str
    session_ns: int
    published_ns: int
    sequence: int
    data: bytes
    part: int
    moved: bool = False


@dataclass(frozen=True, kw_only=True)
class Part:
    """A file of a recording. wall_offset_ns: wall time less the session's clock."""

    octets: memoryview
    inventory: Inventory
    wall_offset_ns: int

    def messages(self, part: int) -> Iterator[JoinedMessage]:
        """Its messages in the order of the file; part: its number among those joined."""
        for found in _found(self.octets):
            message = found.message
            yield JoinedMessage(
                found.channel.topic,
                found.kind,
                min(message.log_time - self.wall_offset_ns, _LATEST_NS),
                min(message.publish_time - self.wall_offset_ns, _LATEST_NS),
                message.sequence,
                message.data,
                part,
            )


@dataclass(frozen=True, kw_only=True)
class JoinedRecording:
    """Parts that follow each other."""

    parts: Sequence[Part]

    @property
    def metadata(self) -> RecordingMetadata | None:
        """Those of the first part whose facts are not lost."""
        return next(
            (part.inventory.metadata for part in self.parts if part.inventory.metadata), None
        )

    @property
    def begin_ns(self) -> int:
        """The instant on the session's clock from which exports count.

        When the recording began; where that is lost, the instant of its earliest message.
        """
        metadata = self.parts[0].inventory.metadata
        if metadata is not None:
            return metadata.session_ns
        return self.first_ns()

    def first_ns(self, topics: Sequence[str] | None = None) -> int:
        """The earliest instant of a message on the session's clock, of all or of these channels."""
        return min(_first_ns(part, topics) for part in self.parts)

    @property
    def counts(self) -> Mapping[str, int]:
        """The number of messages by channel; 0 for one that has none."""
        found: dict[str, int] = {}
        for part in self.parts:
            for channel in part.inventory.channels:
                found[channel.topic] = found.get(channel.topic, 0) + channel.messages
        return found

    @property
    def schemas(self) -> Mapping[str, str]:
        """By channel that has messages: the name of its schema."""
        return {
            channel.topic: channel.schema
            for part in self.parts
            for channel in part.inventory.channels
            if channel.messages
        }

    def messages(self) -> Iterator[JoinedMessage]:
        """All messages, part by part in the order of the files; wrong instants are moved."""
        for number, part in enumerate(self.parts):
            yield from _settled(part.messages(number))


def _settled(messages: Iterator[JoinedMessage]) -> Iterator[JoinedMessage]:
    """Move each message that lies far from those around it in the file to their middle."""
    behind: deque[int] = deque(maxlen=_AROUND)
    ahead: deque[JoinedMessage] = deque(islice(messages, _AROUND))
    while ahead:
        message = ahead.popleft()
        ahead.extend(islice(messages, 1))
        instant_ns = message.session_ns
        if not behind or abs(instant_ns - behind[-1]) > FAR_NS:
            following = [one.session_ns for one in ahead]
            middle_ns = _middle_ns([*behind], instant_ns, following)
            if abs(instant_ns - middle_ns) > FAR_NS:
                published_ns = message.published_ns
                if abs(published_ns - middle_ns) > FAR_NS:
                    published_ns = middle_ns
                message = message._replace(
                    session_ns=middle_ns, published_ns=published_ns, moved=True
                )
        behind.append(message.session_ns)
        yield message


def _middle_ns(behind: list[int], instant_ns: int, ahead: list[int]) -> int:
    """Where an instant lies by those around it; itself if it may be right, as after a pause."""
    near = min(len(behind), len(ahead))
    if near:
        # As many of both sides: so the first one behind a pause is in the middle.
        return sorted([*behind[-near:], instant_ns, *ahead[:near]])[near]
    others = behind[-1:] or sorted(ahead)[len(ahead) // 2 :][:1] or [instant_ns]
    step_ns = others[0] - instant_ns if ahead else instant_ns - others[0]
    return instant_ns if 0 <= step_ns <= _LONGEST_NS else others[0]


def read_part(octets: memoryview) -> Part:
    """Look through a file; ProtocolError unless it is a recording of this project, of our format.

    The offset of its clocks is in its facts. Where they are lost, a message says it, too.
    """
    inventory = take_inventory(octets)
    refuse_foreign(inventory.scan)
    metadata = inventory.metadata
    if metadata is not None:
        offset_ns = metadata.wall_ns - metadata.session_ns
    elif (offset_ns := _offset_of_messages(octets)) == 0:
        # Where nothing tells it, instants that no table holds count from the earliest one.
        told = [channel for channel in inventory.channels if channel.messages]
        if max((channel.last_ns for channel in told), default=0) > _LATEST_NS:
            offset_ns = min(channel.first_ns for channel in told)
    return Part(octets=octets, inventory=inventory, wall_offset_ns=offset_ns)


def chosen_parts(found: Mapping[int, Part]) -> tuple[dict[int, Part], dict[int, str]]:
    """Choose the parts of one recording among the files with its names.

    found: by the number in the name, in order. Returned: the parts in the order of their instants,
    and why each other one is left out. The first file with facts says which recording it is; one
    whose facts are lost is taken as a part of it.
    """
    known = [part for part in found.values() if part.inventory.metadata is not None]
    taken: dict[int, Part] = {}
    left_out: dict[int, str] = {}
    numbers: set[int] = set()
    for number, part in found.items():
        metadata = part.inventory.metadata
        if metadata is None:
            offset_ns = known[0].wall_offset_ns if known else part.wall_offset_ns
            taken[number] = replace(part, wall_offset_ns=offset_ns)
        elif known[0].inventory.metadata and not metadata.is_of(known[0].inventory.metadata):
            left_out[number] = "it is of another recording"
        elif metadata.part in numbers:
            left_out[number] = f"part {metadata.part} is there already"
        else:
            numbers.add(metadata.part)
            taken[number] = part
    return dict(sorted(taken.items(), key=lambda each: _begin_ns(each[1]))), left_out


def _begin_ns(part: Part) -> int:
    """When a part was begun; where its facts are lost, its earliest instant."""
    metadata = part.inventory.metadata
    return _first_ns(part) if metadata is None else metadata.session_ns


def _first_ns(part: Part, topics: Sequence[str] | None = None) -> int:
    """The earliest instant in it on the session's clock; of an empty part, that of its facts."""
    metadata = part.inventory.metadata
    return min(
        (
            channel.first_ns - part.wall_offset_ns
            for channel in part.inventory.channels
            if channel.messages and (topics is None or channel.topic in topics)
        ),
        default=0 if metadata is None else metadata.session_ns,
    )


def _offset_of_messages(octets: memoryview) -> int:
    for found in _found(octets):
        message = found.message
        try:
            if found.kind == EVENT.full_name:
                return message.log_time - unpack(RecordedEvent, message.data).session_ns
            if found.kind == HAPTIC_SAMPLES.full_name:
                return message.log_time - int(unpack_haptics(message.data)["time_ns"][0])
        except (ProtocolError, IndexError):
            continue
    return 0


def _found(octets: memoryview) -> Iterator[FoundMessage]:
    return (item for item in Scan(octets).items() if isinstance(item, FoundMessage))
