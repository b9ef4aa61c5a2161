"""What a recording says, as typed values, and their octets. A core.

`pack` turns a value into the octets of its schema, `unpack` turns them back. A field of a value has
the name of the schema's field; `wall_ns` is the schema's `timestamp`. Haptic samples are arrays:
`pack_haptics`, `unpack_haptics`.
"""

from collections.abc import Iterable, Mapping, Sequence
from enum import IntEnum
from math import nan
from typing import Annotated, Any, ClassVar, Final, TypeVar

import numpy as np
from google.protobuf.message import DecodeError
from numpy.typing import NDArray

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ProtocolError, refused
from kontur_av.media import CaptureStamp, Quality
from kontur_av.streams.coded_unit import CodedUnit
from pipelines.hand import haptic_trace
from pipelines.hand.hand_topics import DriverState
from pipelines.recording.schemas import (
    FOXGLOVE,
    OWN,
    TIMESTAMP,
    Bool,
    Double,
    Fixed32,
    Int64,
    Level,
    MessageSchema,
    Octets,
    Sfixed64,
    Text,
    Uint32,
    Uint64,
    WallTime,
    message_class,
    numbered,
    record,
)
from pipelines.session.mission_messages import ExperimentShown, LedsShown, PanelShown, RunShown
from pipelines.session.session_metrics import gathered
from telepresence.haptics.axes import AXIS_NAMES, MOST_OWN_AXES, AxisName
from telepresence.link.link_metrics import (
    PathMetrics,
    ReceiverMetrics,
    SenderMetrics,
    SupervisionMetrics,
)

OPUS = "opus"


class Recorded:
    """A value that `pack` takes; every one is a frozen dataclass.

    schema: of its octets. parts: the classes of its nested messages, by their names in the schema.
    """

    __slots__ = ()
    schema: ClassVar[MessageSchema]
    parts: ClassVar[Mapping[str, Any]]


@record("CompressedVideo", "one access unit", package=FOXGLOVE)
class RecordedPicture(Recorded):
    """An access unit (Annex B), captured at `wall_ns` of wall time."""

    wall_ns: Annotated[WallTime, "instant of capture, wall time"]
    frame_id: Annotated[Text, "camera or stream"]
    data: Annotated[Octets, "an Annex B byte stream with exactly one picture"]
    format: Annotated[Text, "`h264` or `h265`"] = "h264"


@record("CompressedAudio", "one packet of sound", package=FOXGLOVE)
class RecordedSound(Recorded):
    """An Opus packet, whose first sample was captured at `wall_ns` of wall time."""

    wall_ns: Annotated[WallTime, "instant of capture of its first sample, wall time"]
    data: Annotated[Octets, "one Opus packet"]
    format: Annotated[Text, "`opus`"] = OPUS


class LogLevel(IntEnum):
    """Levels of `foxglove.Log`."""

    UNKNOWN, DEBUG, INFO, WARNING, ERROR, FATAL = range(6)


@record("Log", "a line for people", package=FOXGLOVE, levels=LogLevel)
class LogLine(Recorded):
    """A line for people. name: what it is about."""

    wall_ns: Annotated[WallTime, "wall time"]
    level: Annotated[Level, "INFO, WARNING or ERROR"]
    message: Annotated[Text, "text"]
    name: Annotated[Text, "what it is about: `link`, `process`, `camera`, …"]
    file: Annotated[Text, "empty"] = ""
    line: Annotated[Fixed32, "0"] = 0


@record("UnitMetadata", "what the access unit of the same sequence number does not say itself")
class UnitMetadata(Recorded):
    capture_ns: Annotated[Int64, "instant of capture, session clock; 0 if not dated"]
    key: Annotated[Bool, "an IDR picture, at which any decoder can start"]
    damaged: Annotated[Bool, "packets of it are missing"]
    shows_loss: Annotated[Bool, "its picture shows a loss: its own, or that of an earlier one"]
    refused: Annotated[Bool, "the decoder returned no picture for it, or one that is too large"]
    dated: Annotated[Bool, "the instant of capture is known"]
    width_px: Annotated[Uint32, "width of its picture, pixels; 0 if refused"]
    height_px: Annotated[Uint32, "height of its picture, pixels"]
    octets: Annotated[Uint32, "length of the access unit; more in front of it are parameter sets"]
    added: Annotated[
        Bool, "no unit of the stream: a key picture behind the unit of this number, to begin with"
    ] = False

    @classmethod
    def of(cls, unit: CodedUnit, stamp: CaptureStamp) -> "UnitMetadata":
        return gathered(
            cls,
            *(unit, stamp),
            shows_loss=stamp.quality is not Quality.FRESH,
            width_px=unit.width,
            height_px=unit.height,
            octets=len(unit.data),
        )


@record("SpacePacket", "a telecommand or its telemetry")
class RecordedPacket(Recorded):
    """A space packet, sent or received at `session_ns`."""

    session_ns: Annotated[Int64, "instant at which it was sent or received, session clock"]
    data: Annotated[Octets, "the packet, with its primary header (CCSDS 133.0-B-2)"]
    what: Annotated[Text, "the message in words"]


@record("Experiment", "where the experiment is; told when it changes")
class RecordedExperiment(Recorded):
    session_ns: Annotated[Int64, "session clock"]
    phase: Annotated[Text, "`idle`, `preparing`, `offered`, `running`, `ending`"]
    task: Annotated[Text, "present task; empty without"]
    run: Annotated[Uint32, "number of its run"]
    elemop: Annotated[Text, "elementary operation that is executed"]
    ended_run: Annotated[Uint32, "number of the newest run that is over; 0 for none"]
    result: Annotated[Text, "of that: `finished`, `aborted`, `timed_out`, `lost_signal`"]
    reason: Annotated[Text, "why it did not finish"]

    @classmethod
    def of(cls, shown: ExperimentShown, session_ns: int) -> "RecordedExperiment":
        ended = shown.runs[-1] if shown.runs else RunShown("", 0, "", "", None)
        return gathered(cls, ended, shown, session_ns=session_ns, ended_run=ended.run)


@record("Panel", "what the mission control panel shows; told when it changes")
class RecordedPanel(Recorded):
    session_ns: Annotated[Int64, "session clock"]
    mode: Annotated[Text, "`no_contact`, `wait_task`, `task_info`, `move_to_start`, `hold`, …"]
    task: Annotated[Text, "present task; empty without"]
    run: Annotated[Uint32, "number of its run; 0 without"]
    words: Annotated[Text, "what the cosmonaut is told to do"]
    goal: Annotated[Text, "what has to be done now: `reach`, `circle`, `spring`, …; empty without"]
    step: Annotated[Uint32, "the goal is this one of `steps`"]
    steps: Annotated[Uint32, "goals of the run"]
    dead_man: Annotated[Bool, "the dead-man button is pressed"]

    @classmethod
    def of(cls, shown: PanelShown, session_ns: int) -> "RecordedPanel":
        return gathered(cls, shown, session_ns=session_ns)


@record("LedPanel", "what the LED panel shows; told when it changes")
class RecordedLeds(Recorded):
    session_ns: Annotated[Int64, "session clock"]
    pattern: Annotated[Text, "`dark`, `leds`, `spot`, `contour`, `line`, `spring`, `free`"]
    leds: Annotated[Uint32, "a bit for each lit LED"]
    spot_x_m: Annotated[Double, "place of the spot, m"]
    spot_y_m: Annotated[Double, "place of the spot, m"]

    @classmethod
    def of(cls, shown: LedsShown, session_ns: int) -> "RecordedLeds":
        spot_x_m, spot_y_m = shown.spot_m
        place = {"spot_x_m": spot_x_m, "spot_y_m": spot_y_m}
        return gathered(cls, shown, session_ns=session_ns, pattern=shown.pattern.value, **place)


@record("Driver", "who has the handle, and where a policy wants the robot; told when it changes")
class RecordedDriver(Recorded):
    session_ns: Annotated[Int64, "session clock"]
    who: Annotated[Text, "a person or a policy; empty: nobody"]
    policy: Annotated[Text, "the policy that is there and may drive"]
    drives: Annotated[Bool, "the policy presses the dead-man button: it is obeyed"]
    axes: Annotated[Sequence[Text], "the robot's axes"]
    wanted: Annotated[Sequence[Double], "by axis, m or rad; empty: nowhere"]

    @classmethod
    def of(cls, state: DriverState, session_ns: int) -> "RecordedDriver":
        return gathered(cls, state, session_ns=session_ns)


@record("TransferFrames", "frames of the radio link; both fields have the same number of values")
class RecordedFrames(Recorded):
    """Transfer frames, and when each was sent or received."""

    time_ns: Annotated[
        Sequence[Sfixed64], "instant at which it was sent or received, session clock"
    ]
    data: Annotated[Sequence[Octets], "the frame, with its check"]

    def __post_init__(self) -> None:
        if len(self.time_ns) != len(self.data):
            raise ValueError(f"{len(self.data)} frames with {len(self.time_ns)} instants")


@record("Carried")
class CarriedOctets:
    """Octets of frames, by what they carried."""

    what: Annotated[Text, "haptic, voice, video, header, idle, …"]
    octets: Annotated[Uint64, "octets"]


@record("Queue")
class QueueState:
    """What waits in the queue of a level, and what went through it."""

    level: Annotated[Text, "level"]
    packets: Annotated[Uint32, "packets that wait"]
    octets: Annotated[Uint32, "octets that wait"]
    oldest_age_ns: Annotated[Int64, "age of the oldest packet, ns"]
    accepted: Annotated[Uint64, "packets put into the queue"]
    dropped: Annotated[Uint64, "packets dropped"]


@record("LinkSent", "a direction of the link at its sender; counts are since its process began")
class LinkSent(Recorded):
    session_ns: Annotated[Int64, "session clock"]
    capacity_bps: Annotated[Uint32, "of the channel, bit/s"]
    frames: Annotated[Uint64, "frames sent"]
    haptic_sent: Annotated[Uint64, "haptic samples sent"]
    haptic_superseded: Annotated[Uint64, "samples that a newer one replaced before their slot came"]
    carried: Annotated[Sequence[CarriedOctets], "octets of all frames, by what they carried"]
    queues: Annotated[Sequence[QueueState], "by level"]
    delay_ns: Annotated[Int64, "delay of the radio path, ns"]
    radio_frames_lost: Annotated[Uint64, "frames that the radio path lost"]
    signal: Annotated[Bool, "the sender hears its peer"]
    state: Annotated[Text, "the sender's state of the connection"]

    @classmethod
    def of(
        cls,
        sender: SenderMetrics,
        radio: PathMetrics,
        supervision: SupervisionMetrics,
        *,
        session_ns: int,
    ) -> "LinkSent":
        """Return what a gateway counts of the direction that it sends."""
        return gathered(
            cls,
            *(sender, radio, supervision),
            session_ns=session_ns,
            carried=tuple(
                CarriedOctets(what=what, octets=octets) for what, octets in sender.octets.items()
            ),
            queues=tuple(
                gathered(QueueState, queue, level=level, dropped=sum(queue.drops.values()))
                for level, queue in sender.queue.items()
            ),
            radio_frames_lost=radio.frames_lost,
        )


@record(
    "LinkReceived", "a direction of the link at its receiver; counts are since its process began"
)
class LinkReceived(Recorded):
    session_ns: Annotated[Int64, "session clock"]
    frames: Annotated[Uint64, "good frames"]
    frames_lost: Annotated[Uint64, "frames that are missing"]
    frames_dropped: Annotated[Uint64, "frames that were refused"]
    haptic_received: Annotated[Uint64, "haptic samples received"]
    packets: Annotated[Uint64, "packets delivered"]
    packets_dropped: Annotated[Uint64, "packets dropped"]
    signal: Annotated[Bool, "good frames arrive"]
    state: Annotated[Text, "the receiver's state of the connection"]

    @classmethod
    def of(
        cls, receiver: ReceiverMetrics, supervision: SupervisionMetrics, *, session_ns: int
    ) -> "LinkReceived":
        """Return what a gateway counts of the direction that it receives."""
        return gathered(
            cls,
            *(receiver, supervision),
            session_ns=session_ns,
            frames=receiver.frames_received,
            frames_dropped=sum(receiver.frames_dropped.values()),
            packets=sum(receiver.packets.values()),
            packets_dropped=sum(receiver.packets_dropped.values()),
        )


@record("Event", "something that happened")
class RecordedEvent(Recorded):
    """Something that happened. number: counts the events of the session from 1."""

    session_ns: Annotated[Int64, "session clock"]
    number: Annotated[Uint32, "counts the events of the session from 1"]
    what: Annotated[Text, "`link`, `process`, `camera`, `stale`, `touch`, `recorder`, …"]
    text: Annotated[Text, "a line for people"]


@record("Loss")
class ChannelLoss:
    """Messages of a channel that are not in the file.

    missed: gone before they were read. dropped: read, but the disk was too slow or full.
    """

    channel: Annotated[Text, "channel"]
    missed: Annotated[Uint64, "messages that were gone before they were read"]
    dropped: Annotated[Uint64, "messages dropped because the disk was too slow or full"]


@record(
    "RecorderLosses",
    "what the recorder could not keep since it began; written when a count has changed",
)
class RecorderLosses(Recorded):
    session_ns: Annotated[Int64, "session clock"]
    losses: Annotated[Sequence[ChannelLoss], "by channel"]


@record("Figure")
class RecordedFigure:
    """The value of a figure: a number, or a text."""

    name: Annotated[Text, "as in the session's report, without `streams.`"]
    number: Annotated[Double, "its value; NaN for a text, or while it is not known"]
    text: Annotated[Text, "its value if it is a text"]

    @classmethod
    def of(cls, name: str, value: float | str | bool | None) -> "RecordedFigure":
        if isinstance(value, str):
            return cls(name=name, number=nan, text=value)
        return cls(name=name, number=nan if value is None else float(value), text="")


@record(
    "Figures", "figures of the session that have changed since the message before; at first all"
)
class RecordedMetrics(Recorded):
    session_ns: Annotated[Int64, "session clock"]
    metrics: Annotated[Sequence[RecordedFigure], "one for each"]


@record("Parameter")
class ParameterValue:
    """The value of a parameter of an application: a number, or a text."""

    name: Annotated[Text, "its name"]
    unit: Annotated[Text, "its unit, as the component writes it; empty without"]
    number: Annotated[Double, "its value, 1 for true; NaN for a text"]
    text: Annotated[Text, "its value if it is a text or a choice"]

    @classmethod
    def of(cls, name: str, unit: str, value: float | str | bool) -> "ParameterValue":
        if isinstance(value, str):
            return cls(name=name, unit=unit, number=nan, text=value)
        return cls(name=name, unit=unit, number=float(value), text="")


@record("Parameters", "values that an application has reported")
class RecordedParameters(Recorded):
    session_ns: Annotated[Int64, "instant at which the report was sent or received, session clock"]
    values: Annotated[Sequence[ParameterValue], "one for each parameter of the report"]


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
    with refused(kind.schema.full_name, ValueError, raising=ProtocolError):
        return kind(**found)


def parse_message(schema: MessageSchema, octets: bytes) -> Any:
    """Return protobuf's message; ProtocolError for octets of something else."""
    message = message_class(schema)()
    with refused(schema.full_name, DecodeError, raising=ProtocolError):
        message.ParseFromString(octets)
    return message


def _text(value: object) -> object:
    """Protobuf refuses text that is not Unicode, such as a file's name on a foreign disk."""
    return value.encode("utf-8", "replace").decode() if isinstance(value, str) else value


_PLACES = [AxisName(name).place for name in AXIS_NAMES]
_OWN_FIELDS = [
    (f"own_{own}", f"own_{own}_force", f"own_{own}_uj") for own in range(1, MOST_OWN_AXES + 1)
]
#: Cycles of one end of the hand: columns, so no record.
HAPTIC_SAMPLES = MessageSchema(
    package=OWN,
    name="HapticSamples",
    what="cycles of one end of the hand, 1 kHz; all fields have the same number of values, or, of "
    "an axis that the session does not have, none",
    fields=numbered(
        ("sfixed64[]", "time_ns", "instant of the cycle, session clock"),
        ("sfixed32[]", "sequence", "number of the sample on the link, 0 to 65535; -1: none"),
        *(("float[]", each.name, each.what) for each in haptic_trace.FIRST_FIELDS),
        (
            "fixed32[]",
            "flags",
            "bit 0 contact, 1 dead-man, 2 passivity acted; 8 to 11 joystick's state; "
            "16 to 23 lit LED + 1",
        ),
        *(
            ("float[]", field, what)
            for place in _PLACES
            for field, what in zip(
                haptic_trace.axis_columns(place),
                ("as `x_m`", "as `fx_n`", "as `energy_uj`"),
                strict=True,
            )
        ),
        ("string[]", "own_axes", "places of the robot's own axes with their units, as `pan_rad`"),
        *(
            ("float[]", field, f"of the axis {own} in `own_axes`, as `{like}`")
            for own, fields in enumerate(_OWN_FIELDS, 1)
            for field, like in zip(fields, ("x_m", "fx_n", "energy_uj"), strict=True)
        ),
        *(("float[]", each.name, each.what) for each in haptic_trace.LATER_FIELDS),
    ),
)
_AXIS_FIELDS = [field for place in _PLACES for field in haptic_trace.axis_columns(place)]
_OWN = [field for fields in _OWN_FIELDS for field in fields]
#: A haptic sample of a recording; fields as in the schema. More axes have theirs behind it.
SAMPLE: Final = np.dtype(
    [
        ("time_ns", "<i8"),
        ("sequence", "<i4"),
        *((each.name, "<f4") for each in haptic_trace.FIELDS),
        ("flags", "<u4"),
    ]
)
VIDEO, AUDIO, LOG = RecordedPicture.schema, RecordedSound.schema, LogLine.schema
UNIT_METADATA, SPACE_PACKET = UnitMetadata.schema, RecordedPacket.schema
TRANSFER_FRAMES, LINK_SENT = RecordedFrames.schema, LinkSent.schema
LINK_RECEIVED, EVENT = LinkReceived.schema, RecordedEvent.schema
LOSSES, METRICS = RecorderLosses.schema, RecordedMetrics.schema
EXPERIMENT, LED_PANEL = RecordedExperiment.schema, RecordedLeds.schema
MISSION_PANEL, DRIVER = RecordedPanel.schema, RecordedDriver.schema
PARAMETERS = RecordedParameters.schema
#: All schemas; a channel names its own by its place here.
SCHEMAS = (
    *(VIDEO, AUDIO, LOG, UNIT_METADATA, HAPTIC_SAMPLES, SPACE_PACKET, TRANSFER_FRAMES),
    *(LINK_SENT, LINK_RECEIVED, EVENT, LOSSES, METRICS, EXPERIMENT, LED_PANEL, MISSION_PANEL),
    *(DRIVER, PARAMETERS),
)
#: The `sequence` of a cycle without a sample on the link.
NO_SAMPLE: Final = haptic_trace.NO_SAMPLE


def _sample_type(axis_fields: Iterable[str]) -> "np.dtype[np.void]":
    return np.dtype(SAMPLE.descr + [(name, "<f4") for name in axis_fields])


def _own_fields(places: Sequence[str]) -> dict[str, str]:
    """The schema's fields of a robot's own axes, by their columns."""
    columns = [field for place in places for field in haptic_trace.axis_columns(place)]
    return dict(zip(columns, _OWN, strict=False))


def haptic_samples(
    rows: NDArray[np.void], sequences: NDArray[np.int32] | None = None
) -> NDArray[np.void]:
    """Return rows of a haptic trace (`haptic_trace.ROW`) as samples: (rows,), dtype `SAMPLE`.

    sequences: (rows,), the number of each cycle's sample on the link; None: not known.
    """
    places = haptic_trace.more_places(rows.dtype.names or ())
    axes = [field for place in places for field in haptic_trace.axis_columns(place)]
    samples = np.empty(len(rows), _sample_type(axes))
    for name in samples.dtype.names or ():
        if name != "sequence":
            samples[name] = rows[name]
    samples["sequence"] = NO_SAMPLE if sequences is None else sequences
    return samples


def pack_haptics(samples: NDArray[np.void]) -> bytes:
    """Return the octets of samples: (n,), dtype `SAMPLE`, or with more axes."""
    message = message_class(HAPTIC_SAMPLES)()
    places = haptic_trace.more_places(samples.dtype.names or ())
    own = [place for place in places if place not in _PLACES]
    fields = _own_fields(own)
    message.own_axes.extend(own)
    for name in samples.dtype.names or ():
        getattr(message, fields.get(name, name)).extend(samples[name].tolist())
    return bytes(message.SerializeToString())


def unpack_haptics(octets: bytes) -> NDArray[np.void]:
    """Return the samples of these octets: (n,), dtype `SAMPLE`, or with more axes.

    A field that the recording's version did not have is NaN. ProtocolError for octets of anything
    else.
    """
    message = parse_message(HAPTIC_SAMPLES, octets)
    fields = _own_fields(message.own_axes)
    more = [*(name for name in _AXIS_FIELDS if getattr(message, name)), *fields]
    names = (*(SAMPLE.names or ()), *more)
    columns = {name: getattr(message, fields.get(name, name)) for name in names}
    later = [each.name for each in haptic_trace.LATER_FIELDS]
    columns |= {name: [nan] * len(message.time_ns) for name in later if not columns[name]}
    lengths = {len(column) for column in columns.values()}
    if len(lengths) != 1:
        raise ProtocolError(f"{HAPTIC_SAMPLES.full_name}: fields of {sorted(lengths)} values")
    samples = np.empty(lengths.pop(), _sample_type(more))
    for name, column in columns.items():
        samples[name] = column
    return samples
