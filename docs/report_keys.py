"""The tables of a report's keys for the documents, made from the types and their comments."""

import inspect
import types
import typing
from collections.abc import Container, Iterator, Mapping

from kontur_av.codecs.decoder import DecoderCounts
from kontur_av.streams.paced_sender import SenderCounts
from kontur_av.streams.video_receiver import VideoReceiverCounts
from kontur_av.streams.video_sender import FeedbackCounts
from kontur_av.streams.voice_receiver import LoudspeakerCounts, VoiceReceiverCounts
from pipelines.link.link_metrics import SocketMetrics, WayInMetrics
from pipelines.media.media_metrics import (
    CaptureMetrics,
    CompositionMetrics,
    DisplayMetrics,
    EncoderMetrics,
    FocusMetrics,
    GainMetrics,
    SelectorMetrics,
    SnapshotMetrics,
)
from pipelines.mission.mission_metrics import ComponentMetrics, TaskMetrics, TmtcMetrics
from pipelines.packets.bridge import FrameMetrics, PacketsMetrics
from pipelines.partner.partner_metrics import RtcMetrics
from pipelines.recording.recorder_metrics import FoxgloveMetrics, RecorderMetrics
from pipelines.report.model import (
    ProcessReport,
    SessionReport,
    StreamReport,
    keys_of,
)
from pipelines.report.schema import comments, is_record
from pipelines.seats.page_metrics import PageMetrics
from pipelines.session.session_metrics import (
    LoopMetrics,
    ProbeMetrics,
    RequestMetrics,
    TrainerMetrics,
)
from telepresence.files.entity import FileMetrics
from telepresence.haptics.authority import AuthorityMetrics
from telepresence.haptics.envelope import SafetyMetrics
from telepresence.haptics.haptic_metrics import (
    JoystickMetrics,
    PortMetrics,
    PressMetrics,
    SamplesReceived,
    SamplesSent,
    UdpMetrics,
    WallMetrics,
)
from telepresence.link.link_metrics import GatewayMetrics, PeerMetrics
from telepresence.services.streams import ServiceMetrics

#: All records that processes tell.
TOLD: tuple[type, ...] = (
    ProbeMetrics,
    RequestMetrics,
    LoopMetrics,
    CaptureMetrics,
    CompositionMetrics,
    SelectorMetrics,
    FocusMetrics,
    SenderCounts,
    FeedbackCounts,
    EncoderMetrics,
    GainMetrics,
    VideoReceiverCounts,
    DecoderCounts,
    VoiceReceiverCounts,
    DisplayMetrics,
    LoudspeakerCounts,
    SnapshotMetrics,
    GatewayMetrics,
    SocketMetrics,
    WayInMetrics,
    PeerMetrics,
    SamplesSent,
    SamplesReceived,
    PortMetrics,
    PressMetrics,
    WallMetrics,
    UdpMetrics,
    JoystickMetrics,
    AuthorityMetrics,
    SafetyMetrics,
    TmtcMetrics,
    PacketsMetrics,
    FrameMetrics,
    FileMetrics,
    ServiceMetrics,
    TaskMetrics,
    ComponentMetrics,
    TrainerMetrics,
    PageMetrics,
    RtcMetrics,
    RecorderMetrics,
    FoxgloveMetrics,
)
#: Of these records the page has a sentence for each key; of all others the names.
EXPLAINED: tuple[type, ...] = (
    SessionReport,
    StreamReport,
    ProcessReport,
)
#: Keys of percentiles, and of events, which the page has once.
PERCENTILES = ("p50", "p95", "p99", "max", "p99.9")
SMALL = (*PERCENTILES, "mean", "count", "at_ns", "what")


def report_keys() -> str:
    """The keys of a session's report, by their place in it.

    A record with SMALL keys alone has its sentence, if its place does not say as much.
    """
    said: set[tuple[str, str]] = set()
    placed = {
        place.partition(".")[0].removesuffix("[]") for place in _places(SessionReport).values()
    }
    placed.discard("exercises")
    parts = []
    for kind, place in _places(SessionReport).items():
        title = f"**`{place}`**: {_summary(kind)}" if place else f"{_summary(kind)}"
        if place.partition(".")[0] == "trace":
            # Of `report join` alone.
            continue
        if kind in EXPLAINED:
            # What has a place of its own is explained there.
            without = placed if kind is SessionReport else set()
            parts.append("\n".join([title + "\n", *_explained(kind, said, without)]))
        elif not {key for key, _, _ in _rows(kind)} <= {*SMALL}:
            names = [f"`{key}`" for key, _, _ in _rows(kind) if key not in PERCENTILES]
            parts.append(f"{title} {', '.join(names)}")
        elif not _summary(kind).startswith(("Percentiles", "Something")):
            parts.append(title)
    small = ", ".join(f"`{key}`" for key in SMALL)
    parts.append(f"Of percentiles and events, where they have them: {small}")
    return "\n\n".join(parts) + "\n"


def counts() -> str:
    """What processes count that has no place of its own in the report, by what it is of."""
    placed = set(_places(SessionReport, flat=True))
    lines = []
    for kind in TOLD:
        names = [f"`{key}`" for key, _, _ in _rows(kind)]
        lines += [] if kind in placed else [f"- {_summary(kind)} {', '.join(names)}"]
    return "\n".join(lines) + "\n"


def _explained(kind: type, said: set[tuple[str, str]], without: Container[str]) -> Iterator[str]:
    """An item for each key; those that were explained before, or need no words, share one."""
    rows = [row for row in _rows(kind) if row[0] not in without]
    of_all = {row[:2] for row in rows} - {
        row[:2] for row in rows if [other[:2] for other in rows].count(row[:2]) == 1 and row[2]
    }
    rows = [(key, told, "" if (key, told) in of_all else of) for key, told, of in rows]
    for group in dict.fromkeys(["", *(of for _, _, of in rows)]):
        if group:
            yield f"\n*{group}*\n"
        short, here = [], set[str]()
        for key, told, of in rows:
            if of != group or f"`{key}`" in short:
                continue
            if told and (key, told) not in said:
                said.add((key, told))
                here.add(key)
                yield f"- `{key}`: {told}"
            elif key not in here:
                short.append(f"`{key}`")
        if short:
            yield f"- {', '.join(short)}"


def _places(kind: type, *, flat: bool = False) -> dict[type, str]:
    """By record below `kind`: where it first stands, such as `streams.NAME.latency_ms`.

    flat: also those whose keys stand in the record that holds them.
    """
    found = {kind: ""}
    waiting = [kind]
    for one in waiting:
        for key, hint, is_flat in _fields(one):
            for below in _records(hint):
                path = ".".join(filter(None, (found[one], key))) + _by_name(hint)
                if below not in found and (flat or not is_flat):
                    found[below] = path
                    waiting.append(below)
    return found


def _fields(kind: type) -> Iterator[tuple[str, object, bool]]:
    """The keys of a record with their types, also those of the flat ones in it."""
    hints = typing.get_type_hints(kind)
    for name, key, _, flat in keys_of(kind):
        for record in _records(hints[name]) if flat else ():
            yield "", record, True
            yield from _fields(record)
        if not flat:
            yield key, hints[name], False


def _by_name(hint: object) -> str:
    """`.NAME` for a mapping, `[]` for a list."""
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin in (types.UnionType, typing.Union):
        return next(filter(None, map(_by_name, arguments)), "")
    return {dict: ".NAME", Mapping: ".NAME", list: "[]", tuple: "[]"}.get(origin, "")


def _summary(kind: type) -> str:
    return (inspect.getdoc(kind) or "").splitlines()[0]


def _rows(kind: type, of: str = "") -> Iterator[tuple[str, str, str]]:
    """Each key with its sentence, and of which kind of stream alone it is.

    The keys of a flat record stand in the place of its own.
    """
    texts, hints = comments(kind), typing.get_type_hints(kind)
    for name, key, _, flat in keys_of(kind):
        if not flat:
            yield key, texts.get(name, ""), of
            continue
        for record in _records(hints[name]):
            group = texts.get(name, "")
            yield from _rows(record, of or (group if group.startswith("Of ") else ""))


def _records(hint: object) -> Iterator[type]:
    if isinstance(hint, type) and is_record(hint):
        yield hint
    for argument in typing.get_args(hint):
        yield from _records(argument)
