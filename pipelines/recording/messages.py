"""What a recording says, as typed values, and their octets. A core.

`pack` turns a value into the octets of its schema, `unpack` turns them back. A field of a value has
the name of the schema's field; `wall_ns` is the schema's `timestamp`. Haptic samples are arrays:
`pack_haptics`, `unpack_haptics`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from math import nan
from types import MappingProxyType
from typing import Any, ClassVar, Final, TypeVar

import numpy as np
from google.protobuf.message import DecodeError
from numpy.typing import NDArray

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ProtocolError
from kontur_av.media import CaptureStamp, Quality
from kontur_av.streams.coded_unit import CodedUnit
from pipelines.hand import haptic_trace
from pipelines.recording.schemas import (
    AUDIO,
    EVENT,
    FIGURES,
    HAPTIC_SAMPLES,
    LINK_RECEIVED,
    LINK_SENT,
    LOG,
    LOSSES,
    SPACE_PACKET,
    TIMESTAMP,
    TRANSFER_FRAMES,
    UNIT_FACTS,
    VIDEO,
    MessageSchema,
    message_class,
)
from telepresence.haptics.mediated.wall import parse_wall
from telepresence.link.figures import (
    PathFigures,
    ReceiverFigures,
    SenderFigures,
    SupervisionFigures,
)
from telepresence.tmtc.pus.head import apid_of, is_packet, is_telecommand, message_of

H264, OPUS = "h264", "opus"


class Recorded:
    """A value that `pack` takes; every one is a frozen dataclass.

    schema: of its octets. parts: the classes of its nested messages, by their names in the schema.
    """

    __slots__ = ()
    schema: ClassVar[MessageSchema]
    parts: ClassVar[Mapping[str, Any]] = MappingProxyType({})


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedPicture(Recorded):
    """An access unit (Annex B), captured at `wall_ns` of wall time."""

    schema = VIDEO
    wall_ns: int
    frame_id: str
    data: bytes
    format: str = H264


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedSound(Recorded):
    """An Opus packet, whose first sample was captured at `wall_ns` of wall time."""

    schema = AUDIO
    wall_ns: int
    data: bytes
    format: str = OPUS


class LogLevel(IntEnum):
    """Levels of `foxglove.Log`."""

    UNKNOWN, DEBUG, INFO, WARNING, ERROR, FATAL = range(6)


@dataclass(frozen=True, slots=True, kw_only=True)
class LogLine(Recorded):
    """A line for people. name: what it is about."""

    schema = LOG
    wall_ns: int
    level: int
    message: str
    name: str
    file: str = ""
    line: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class UnitFacts(Recorded):
    """What an access unit does not say itself; fields as in the schema."""

    schema = UNIT_FACTS
    capture_ns: int
    key: bool
    damaged: bool
    shows_loss: bool
    refused: bool
    dated: bool
    width_px: int
    height_px: int
    octets: int
    added: bool = False

    @classmethod
    def of(cls, unit: CodedUnit, stamp: CaptureStamp) -> "UnitFacts":
        """Return the facts of a sample of a topic."""
        return cls(
            capture_ns=stamp.capture_ns,
            key=unit.key,
            damaged=unit.damaged,
            shows_loss=stamp.quality is not Quality.FRESH,
            refused=unit.refused,
            dated=unit.dated,
            width_px=unit.width,
            height_px=unit.height,
            octets=len(unit.data),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedPacket(Recorded):
    """A space packet, sent or received at `session_ns`."""

    schema = SPACE_PACKET
    session_ns: int
    data: bytes
    what: str


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedFrames(Recorded):
    """Transfer frames, and when each was sent or received."""

    schema = TRANSFER_FRAMES
    time_ns: Sequence[int]
    data: Sequence[bytes]

    def __post_init__(self) -> None:
        if len(self.time_ns) != len(self.data):
            raise ValueError(f"{len(self.data)} frames with {len(self.time_ns)} instants")


@dataclass(frozen=True, slots=True, kw_only=True)
class CarriedOctets:
    """Octets of frames, by what they carried."""

    what: str
    octets: int


@dataclass(frozen=True, slots=True, kw_only=True)
class QueueState:
    """What waits in the queue of a level, and what went through it."""

    level: str
    packets: int
    octets: int
    oldest_age_ns: int
    accepted: int
    dropped: int


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkSent(Recorded):
    """A direction of the link at its sender; fields as in the schema."""

    schema = LINK_SENT
    parts = MappingProxyType({"Carried": CarriedOctets, "Queue": QueueState})
    session_ns: int
    capacity_bps: int
    frames: int
    haptic_sent: int
    haptic_superseded: int
    carried: Sequence[CarriedOctets]
    queues: Sequence[QueueState]
    delay_ns: int
    radio_frames_lost: int
    signal: bool
    state: str

    @classmethod
    def of(
        cls,
        sender: SenderFigures,
        radio: PathFigures,
        supervision: SupervisionFigures,
        *,
        session_ns: int,
    ) -> "LinkSent":
        """Return what a gateway counts of the direction that it sends."""
        return cls(
            session_ns=session_ns,
            capacity_bps=sender.capacity_bps,
            frames=sender.frames,
            haptic_sent=sender.haptic_sent,
            haptic_superseded=sender.haptic_superseded,
            carried=tuple(
                CarriedOctets(what=what, octets=octets) for what, octets in sender.octets.items()
            ),
            queues=tuple(
                QueueState(
                    level=level,
                    packets=queue.packets,
                    octets=queue.octets,
                    oldest_age_ns=queue.oldest_age_ns,
                    accepted=queue.accepted,
                    dropped=sum(queue.drops.values()),
                )
                for level, queue in sender.queue.items()
            ),
            delay_ns=radio.delay_ns,
            radio_frames_lost=radio.frames_lost,
            signal=supervision.signal,
            state=supervision.state,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkReceived(Recorded):
    """A direction of the link at its receiver; fields as in the schema."""

    schema = LINK_RECEIVED
    session_ns: int
    frames: int
    frames_lost: int
    frames_dropped: int
    haptic_received: int
    packets: int
    packets_dropped: int
    signal: bool
    state: str

    @classmethod
    def of(
        cls, receiver: ReceiverFigures, supervision: SupervisionFigures, *, session_ns: int
    ) -> "LinkReceived":
        """Return what a gateway counts of the direction that it receives."""
        return cls(
            session_ns=session_ns,
            frames=receiver.frames_received,
            frames_lost=receiver.frames_lost,
            frames_dropped=sum(receiver.frames_dropped.values()),
            haptic_received=receiver.haptic_received,
            packets=sum(receiver.packets.values()),
            packets_dropped=sum(receiver.packets_dropped.values()),
            signal=supervision.signal,
            state=supervision.state,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedEvent(Recorded):
    """Something that happened. number: counts the events of the session from 1."""

    schema = EVENT
    session_ns: int
    number: int
    what: str
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class ChannelLoss:
    """Messages of a channel that are not in the file.

    missed: gone before they were read. dropped: read, but the disk was too slow or full.
    """

    channel: str
    missed: int
    dropped: int


@dataclass(frozen=True, slots=True, kw_only=True)
class RecorderLosses(Recorded):
    """What the recorder could not keep since it began."""

    schema = LOSSES
    parts = MappingProxyType({"Loss": ChannelLoss})
    session_ns: int
    losses: Sequence[ChannelLoss]


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedFigure:
    """The value of a figure: a number, or a text."""

    name: str
    number: float
    text: str

    @classmethod
    def of(cls, name: str, value: float | str | bool | None) -> "RecordedFigure":
        """Return a figure of a report."""
        if isinstance(value, str):
            return cls(name=name, number=nan, text=value)
        return cls(name=name, number=nan if value is None else float(value), text="")


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedFigures(Recorded):
    """Figures of the session that have changed."""

    schema = FIGURES
    parts = MappingProxyType({"Figure": RecordedFigure})
    session_ns: int
    figures: Sequence[RecordedFigure]


Value = TypeVar("Value", bound=Recorded)


def pack(value: Recorded) -> bytes:
    """Return the octets of a value. ValueError for a number that its field cannot hold."""
    message = message_class(value.schema)()
    for row in value.schema.fields:
        if row.type == TIMESTAMP:
            seconds, nanos = divmod(value.wall_ns, NS_PER_S)  # type: ignore[attr-defined]
            message.timestamp.seconds, message.timestamp.nanos = seconds, nanos
            continue
        given = getattr(value, row.name)
        if row.type in value.parts:
            parts = getattr(message, row.name)
            for part in given:
                parts.add(**{key: _text(getattr(part, key)) for key in part.__slots__})
        elif row.repeated:
            getattr(message, row.name).extend(given)
        else:
            setattr(message, row.name, _text(given))
    return bytes(message.SerializeToString())


def unpack(kind: type[Value], octets: bytes) -> Value:
    """Return the value of these octets; ProtocolError for octets of something else."""
    message = parse_message(kind.schema, octets)
    found: dict[str, object] = {}
    for row in kind.schema.fields:
        value = getattr(message, row.name)
        if row.type == TIMESTAMP:
            found["wall_ns"] = value.seconds * NS_PER_S + value.nanos
        elif row.type in kind.parts:
            part = kind.parts[row.type]
            found[row.name] = tuple(
                part(**{key: getattr(one, key) for key in part.__slots__}) for one in value
            )
        else:
            found[row.name] = tuple(value) if row.repeated else value
    try:
        return kind(**found)
    except ValueError as error:
        raise ProtocolError(f"{kind.schema.full_name}: {error}") from None


def parse_message(schema: MessageSchema, octets: bytes) -> Any:
    """Return protobuf's message; ProtocolError for octets of something else."""
    message = message_class(schema)()
    try:
        message.ParseFromString(octets)
    except DecodeError as error:
        raise ProtocolError(f"{schema.full_name}: {error}") from None
    return message


def _text(value: object) -> object:
    """Protobuf refuses text that is not Unicode, such as a file's name on a foreign disk."""
    return value.encode("utf-8", "replace").decode() if isinstance(value, str) else value


#: A haptic sample of a recording; fields as in the schema.
SAMPLE: Final = np.dtype(
    [
        ("time_ns", "<i8"),
        ("sequence", "<i4"),
        ("x_m", "<f4"),
        ("y_m", "<f4"),
        ("fx_n", "<f4"),
        ("fy_n", "<f4"),
        ("energy_uj", "<f4"),
        ("flags", "<u4"),
    ]
)
#: The `sequence` of a cycle without a sample on the link.
NO_SAMPLE: Final = haptic_trace.NO_SAMPLE


def haptic_samples(
    rows: NDArray[np.void], sequences: NDArray[np.int32] | None = None
) -> NDArray[np.void]:
    """Return rows of a haptic trace (`haptic_trace.ROW`) as samples: (rows,), dtype `SAMPLE`.

    sequences: (rows,), the number of each cycle's sample on the link; None: not known.
    """
    samples = np.empty(len(rows), SAMPLE)
    for name in SAMPLE.names or ():
        if name != "sequence":
            samples[name] = rows[name]
    samples["sequence"] = NO_SAMPLE if sequences is None else sequences
    return samples


def pack_haptics(samples: NDArray[np.void]) -> bytes:
    """Return the octets of samples: (n,), dtype `SAMPLE`."""
    message = message_class(HAPTIC_SAMPLES)()
    for row in HAPTIC_SAMPLES.fields:
        getattr(message, row.name).extend(samples[row.name].tolist())
    return bytes(message.SerializeToString())


def unpack_haptics(octets: bytes) -> NDArray[np.void]:
    """Return the samples of these octets: (n,), dtype `SAMPLE`; else ProtocolError."""
    message = parse_message(HAPTIC_SAMPLES, octets)
    columns = {row.name: getattr(message, row.name) for row in HAPTIC_SAMPLES.fields}
    lengths = {len(column) for column in columns.values()}
    if len(lengths) != 1:
        raise ProtocolError(f"{HAPTIC_SAMPLES.full_name}: fields of {sorted(lengths)} values")
    samples = np.empty(lengths.pop(), SAMPLE)
    for name, column in columns.items():
        samples[name] = column
    return samples


def _call_words(data: bytes) -> str:
    """Which function a telecommand calls, with its argument if that is a text."""
    octets = data[11:-2]  # between the headers and the check
    text = octets[1:].rstrip(b"\0").decode("latin-1")
    words = f" {text}" if text.isascii() and text.isprintable() else ""
    return f"function {octets[0]}{words}".rstrip() if octets else ""


def packet_words(data: bytes) -> str:
    """Return what a space packet of telecommands or telemetry says, in words."""
    if is_packet(data):
        service, subtype = message_of(data)
        way = "telecommand to" if is_telecommand(data) else "report of"
        words = f"PUS {service},{subtype}: {way} application {apid_of(data):#x}"
        called = _call_words(data) if is_telecommand(data) and (service, subtype) == (8, 1) else ""
        return f"{words}: {called}" if called else words
    try:
        wall = parse_wall(data).wall
    except ProtocolError:
        return "unknown"
    if wall is None:
        return "no wall"
    axis = "xy"[wall.axis]
    return f"wall at {axis} = {wall.surface_m:.4f} m, {wall.stiffness_n_m:.0f} N/m"
