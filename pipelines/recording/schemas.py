"""The protobuf schemas of a recording, as a table. A core.

Those of the package `foxglove` are the public ones (https://docs.foxglove.dev/docs/sdk/schemas), so
that other tools show pictures, sound and log. Those of `kontur_av` are this project's own. A field
of these is only ever added: neither its number nor its meaning changes.

Instants within messages of `kontur_av` are on the session's clock. `timestamp` of those of
`foxglove` is wall time, as the `log_time` of every message is.
"""

from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2

TIMESTAMP = "google.protobuf.Timestamp"
OWN, FOXGLOVE = "kontur_av", "foxglove"

_Proto = descriptor_pb2.FieldDescriptorProto
_SCALARS = {
    "bool": _Proto.TYPE_BOOL,
    "bytes": _Proto.TYPE_BYTES,
    "double": _Proto.TYPE_DOUBLE,
    "fixed32": _Proto.TYPE_FIXED32,
    "float": _Proto.TYPE_FLOAT,
    "int64": _Proto.TYPE_INT64,
    "sfixed32": _Proto.TYPE_SFIXED32,
    "sfixed64": _Proto.TYPE_SFIXED64,
    "string": _Proto.TYPE_STRING,
    "uint32": _Proto.TYPE_UINT32,
    "uint64": _Proto.TYPE_UINT64,
}
_TIMESTAMP_FILE = "google/protobuf/timestamp.proto"


@dataclass(frozen=True, kw_only=True)
class FieldRow:
    """A field: its number on the wire and its protobuf type.

    what: meaning and unit in words. repeated: any number of values, packed if they are numbers.
    """

    name: str
    number: int
    type: str
    what: str
    repeated: bool = False


@dataclass(frozen=True, kw_only=True)
class MessageSchema:
    """A message of protobuf (proto3).

    nested: messages that only this one contains. levels: an enumeration `Level`, from 0 on.
    """

    package: str
    name: str
    what: str
    fields: tuple[FieldRow, ...]
    nested: tuple["MessageSchema", ...] = ()
    levels: tuple[str, ...] = ()

    @property
    def full_name(self) -> str:
        """With its package: the name of the schema in the file."""
        return f"{self.package}.{self.name}"


def _rows(*rows: tuple[str, str, str]) -> tuple[FieldRow, ...]:
    """Fields (type, name, meaning), numbered from 1; a type that ends with [] is repeated."""
    return tuple(
        FieldRow(
            name=name,
            number=number,
            type=kind.removesuffix("[]"),
            what=what,
            repeated=kind.endswith("[]"),
        )
        for number, (kind, name, what) in enumerate(rows, start=1)
    )


def _own(
    name: str, what: str, *rows: tuple[str, str, str], nested: tuple[MessageSchema, ...] = ()
) -> MessageSchema:
    return MessageSchema(package=OWN, name=name, what=what, fields=_rows(*rows), nested=nested)


def _foxglove(
    name: str, what: str, *rows: tuple[str, str, str], levels: tuple[str, ...] = ()
) -> MessageSchema:
    return MessageSchema(package=FOXGLOVE, name=name, what=what, fields=_rows(*rows), levels=levels)


VIDEO = _foxglove(
    "CompressedVideo",
    "one access unit",
    (TIMESTAMP, "timestamp", "instant of capture, wall time"),
    ("string", "frame_id", "camera or stream"),
    ("bytes", "data", "an Annex B byte stream with exactly one picture"),
    ("string", "format", "`h264`"),
)
AUDIO = _foxglove(
    "CompressedAudio",
    "one packet of sound",
    (TIMESTAMP, "timestamp", "instant of capture of its first sample, wall time"),
    ("bytes", "data", "one Opus packet"),
    ("string", "format", "`opus`"),
)
LOG = _foxglove(
    "Log",
    "a line for people",
    (TIMESTAMP, "timestamp", "wall time"),
    ("Level", "level", "INFO, WARNING or ERROR"),
    ("string", "message", "text"),
    ("string", "name", "what it is about: `link`, `process`, `camera`, …"),
    ("string", "file", "empty"),
    ("fixed32", "line", "0"),
    levels=("UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL"),
)
UNIT_FACTS = _own(
    "UnitFacts",
    "what the access unit of the same sequence number does not say itself",
    ("int64", "capture_ns", "instant of capture, session clock; 0 if not dated"),
    ("bool", "key", "an IDR picture, at which any decoder can start"),
    ("bool", "damaged", "packets of it are missing"),
    ("bool", "shows_loss", "its picture shows a loss: its own, or that of an earlier one"),
    ("bool", "refused", "the decoder returned no picture for it, or one that is too large"),
    ("bool", "dated", "the instant of capture is known"),
    ("uint32", "width_px", "width of its picture, pixels; 0 if refused"),
    ("uint32", "height_px", "height of its picture, pixels"),
    ("uint32", "octets", "length of the access unit; more in front of it are parameter sets"),
    ("bool", "added", "no unit of the stream: a key picture that the recorder put ahead of it"),
)
HAPTIC_SAMPLES = _own(
    "HapticSamples",
    "cycles of one end of the hand, 1 kHz; all fields have the same number of values",
    ("sfixed64[]", "time_ns", "instant of the cycle, session clock"),
    ("sfixed32[]", "sequence", "number of the sample on the link, 0 to 65535; -1: none"),
    ("float[]", "x_m", "position of this end's handle or tip, m"),
    ("float[]", "y_m", "as `x_m`"),
    ("float[]", "fx_n", "force that the handle displays, or of the board on the tip, N"),
    ("float[]", "fy_n", "as `fx_n`"),
    ("float[]", "energy_uj", "credit of this end's port, µJ"),
    (
        "fixed32[]",
        "flags",
        "bit 0 contact, 1 dead-man, 2 passivity acted; 8 to 11 joystick's state; "
        "16 to 23 lit LED + 1",
    ),
)
SPACE_PACKET = _own(
    "SpacePacket",
    "a telecommand or its telemetry",
    ("int64", "session_ns", "instant at which it was sent or received, session clock"),
    ("bytes", "data", "the packet, with its primary header (CCSDS 133.0-B-2)"),
    ("string", "what", "the message in words"),
)
TRANSFER_FRAMES = _own(
    "TransferFrames",
    "frames of the radio link; both fields have the same number of values",
    ("sfixed64[]", "time_ns", "instant at which it was sent or received, session clock"),
    ("bytes[]", "data", "the frame, with its check"),
)
LINK_SENT = _own(
    "LinkSent",
    "a direction of the link at its sender; counts are since its process began",
    ("int64", "session_ns", "session clock"),
    ("uint32", "capacity_bps", "of the channel, bit/s"),
    ("uint64", "frames", "frames sent"),
    ("uint64", "haptic_sent", "haptic samples sent"),
    ("uint64", "haptic_superseded", "samples that a newer one replaced before their slot came"),
    ("Carried[]", "carried", "octets of all frames, by what they carried"),
    ("Queue[]", "queues", "by level"),
    ("int64", "delay_ns", "delay of the radio path, ns"),
    ("uint64", "radio_frames_lost", "frames that the radio path lost"),
    ("bool", "signal", "the sender hears its peer"),
    ("string", "state", "the sender's state of the connection"),
    nested=(
        _own(
            "Carried",
            "",
            ("string", "what", "haptic, voice, video, header, idle, …"),
            ("uint64", "octets", "octets"),
        ),
        _own(
            "Queue",
            "",
            ("string", "level", "level"),
            ("uint32", "packets", "packets that wait"),
            ("uint32", "octets", "octets that wait"),
            ("int64", "oldest_age_ns", "age of the oldest packet, ns"),
            ("uint64", "accepted", "packets put into the queue"),
            ("uint64", "dropped", "packets dropped"),
        ),
    ),
)
LINK_RECEIVED = _own(
    "LinkReceived",
    "a direction of the link at its receiver; counts are since its process began",
    ("int64", "session_ns", "session clock"),
    ("uint64", "frames", "good frames"),
    ("uint64", "frames_lost", "frames that are missing"),
    ("uint64", "frames_dropped", "frames that were refused"),
    ("uint64", "haptic_received", "haptic samples received"),
    ("uint64", "packets", "packets delivered"),
    ("uint64", "packets_dropped", "packets dropped"),
    ("bool", "signal", "good frames arrive"),
    ("string", "state", "the receiver's state of the connection"),
)
EVENT = _own(
    "Event",
    "something that happened",
    ("int64", "session_ns", "session clock"),
    ("uint32", "number", "counts the events of the session from 1"),
    ("string", "what", "`link`, `process`, `camera`, `stale`, `contact`, `recorder`, …"),
    ("string", "text", "a line for people"),
)
LOSSES = _own(
    "RecorderLosses",
    "what the recorder could not keep since it began; written when a count has changed",
    ("int64", "session_ns", "session clock"),
    ("Loss[]", "losses", "by channel"),
    nested=(
        _own(
            "Loss",
            "",
            ("string", "channel", "channel"),
            ("uint64", "missed", "messages that were gone before they were read"),
            ("uint64", "dropped", "messages dropped because the disk was too slow or full"),
        ),
    ),
)
FIGURES = _own(
    "Figures",
    "figures of the session that have changed since the message before; at first all",
    ("int64", "session_ns", "session clock"),
    ("Figure[]", "figures", "one for each"),
    nested=(
        _own(
            "Figure",
            "",
            ("string", "name", "as in the session's report, without `streams.`"),
            ("double", "number", "its value; NaN for a text, or while it is not known"),
            ("string", "text", "its value if it is a text"),
        ),
    ),
)

SCHEMAS = (
    VIDEO,
    AUDIO,
    LOG,
    UNIT_FACTS,
    HAPTIC_SAMPLES,
    SPACE_PACKET,
    TRANSFER_FRAMES,
    LINK_SENT,
    LINK_RECEIVED,
    EVENT,
    LOSSES,
    FIGURES,
)


def descriptor_set(schema: MessageSchema) -> bytes:
    """Return the schema as MCAP wants it: a serialised `FileDescriptorSet` with its imports."""
    files = [_timestamp_file()] if _is_dated(schema) else []
    found = descriptor_pb2.FileDescriptorSet(file=[*files, _file(schema)])
    return bytes(found.SerializeToString(deterministic=True))


@cache
def message_class(schema: MessageSchema) -> Any:
    """Return protobuf's class of its messages."""
    return message_factory.GetMessageClass(_pool().FindMessageTypeByName(schema.full_name))


@lru_cache(maxsize=1)
def _pool() -> Any:
    """A pool of our own, in which no other library can have another schema of the same name."""
    pool = descriptor_pool.DescriptorPool()
    for file in (_timestamp_file(), *(_file(schema) for schema in SCHEMAS)):
        pool.AddSerializedFile(file.SerializeToString())
    return pool


def _timestamp_file() -> Any:
    file = descriptor_pb2.FileDescriptorProto()
    timestamp_pb2.DESCRIPTOR.CopyToProto(file)
    return file


def _is_dated(schema: MessageSchema) -> bool:
    return any(row.type == TIMESTAMP for row in schema.fields)


def _file(schema: MessageSchema) -> Any:
    return descriptor_pb2.FileDescriptorProto(
        name=f"{schema.package}/{schema.name}.proto",
        package=schema.package,
        syntax="proto3",
        dependency=[_TIMESTAMP_FILE] if _is_dated(schema) else [],
        message_type=[_message(schema, f".{schema.package}")],
    )


def _message(schema: MessageSchema, scope: str) -> Any:
    scope = f"{scope}.{schema.name}"
    levels = [
        descriptor_pb2.EnumValueDescriptorProto(name=name, number=number)
        for number, name in enumerate(schema.levels)
    ]
    return descriptor_pb2.DescriptorProto(
        name=schema.name,
        field=[_field(row, schema, scope) for row in schema.fields],
        nested_type=[_message(inner, scope) for inner in schema.nested],
        enum_type=[descriptor_pb2.EnumDescriptorProto(name="Level", value=levels)]
        if levels
        else [],
    )


def _field(row: FieldRow, schema: MessageSchema, scope: str) -> Any:
    field = _Proto(
        name=row.name,
        number=row.number,
        label=_Proto.LABEL_REPEATED if row.repeated else _Proto.LABEL_OPTIONAL,
    )
    if row.type in _SCALARS:
        field.type = _SCALARS[row.type]
    elif row.type == "Level":
        field.type, field.type_name = _Proto.TYPE_ENUM, f"{scope}.Level"
    elif row.type == TIMESTAMP:
        field.type, field.type_name = _Proto.TYPE_MESSAGE, f".{TIMESTAMP}"
    else:
        field.type, field.type_name = _Proto.TYPE_MESSAGE, f"{scope}.{row.type}"
    return field
