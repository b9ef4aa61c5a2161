"""The tables of a report's keys for the documents, made from the types and their comments."""

import inspect
import itertools
import types
import typing
from collections.abc import Iterable, Iterator, Mapping

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
from pipelines.report.model import keys_of
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
_WORDS: dict[object, str] = {int: "integer", float: "number", str: "text", bool: "boolean"}


def keys_tables(kind: type, *, without: type | None = None) -> str:
    """A table for `kind` and one for each type below it, in the order in which they come."""
    listed = [] if without is None else _types_below(without)
    parts = []
    for one in _types_below(kind):
        if one in listed:
            continue
        parts.append(f"**{one.__name__}**: {_summary(one)}\n\n" + "\n".join(_listed(_rows(one))))
    return "\n\n".join(parts) + "\n"


def counts_table() -> str:
    """Lists of all that processes count and tell, by the names that it has in a report."""
    parts = []
    for kind in TOLD:
        prefix = "STREAM." if kind is DisplayMetrics else ""
        parts.append(f"**{_summary(kind)}**\n\n" + "\n".join(_listed(_rows(kind, prefix))))
    return "\n\n".join(parts) + "\n"


def _listed(rows: Iterable[tuple[str, str]]) -> list[str]:
    """Items of (key, comment); keys without a comment share an item with their neighbours."""
    items = []
    for what, alike in itertools.groupby(rows, key=lambda row: row[1]):
        keys = [key for key, _ in alike]
        items += [f"- {key}: {what}" for key in keys] if what else [f"- {', '.join(keys)}"]
    return items


def _summary(kind: type) -> str:
    return (inspect.getdoc(kind) or "").splitlines()[0]


def _rows(kind: type, prefix: str = "") -> Iterator[tuple[str, str]]:
    """Each key with its type, unless it is an integer, and its sentence; `?`: may be absent.

    The fields of a flat record stand in the place of its key.
    """
    texts, hints = comments(kind), typing.get_type_hints(kind)
    for name, key, optional, flat in keys_of(kind):
        below = list(_records(hints[name]))
        if flat:
            for record in below:
                yield from _rows(record, prefix)
            continue
        words = _words(hints[name], optional=optional)
        told = f"`{prefix}{key}`" + "?" * optional
        yield told if words == _WORDS[int] else f"{told} ({words})", texts.get(name, "")


def _words(hint: object, *, optional: bool = False) -> str:
    """A type in words."""
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin in (types.UnionType, typing.Union):
        one = next(of for of in arguments if of is not type(None))
        return _words(one) + ("" if optional else " or null")
    if origin in (dict, Mapping):
        return "by name" if arguments[1] is int else f"{_words(arguments[1])}, by name"
    if origin is list:
        return f"list of {_words(arguments[0])}"
    if origin is tuple and Ellipsis in arguments:
        return f"list of {_words(arguments[0])}"
    if origin is tuple:
        return f"[{', '.join(map(_words, arguments))}]"
    return _WORDS.get(hint, getattr(hint, "__name__", str(hint)))


def _types_below(kind: type) -> list[type]:
    """A type, and those below it that have tables of their own: a flat one stands in its parent."""
    found, listed = [kind], [kind]
    for one in found:
        hints = typing.get_type_hints(one)
        for name, _, _, flat in keys_of(one):
            for below in _records(hints[name]):
                found += [] if below in found else [below]
                listed += [] if below in listed or flat else [below]
    return listed


def _records(hint: object) -> Iterator[type]:
    if isinstance(hint, type) and is_record(hint):
        yield hint
    for argument in typing.get_args(hint):
        yield from _records(argument)
