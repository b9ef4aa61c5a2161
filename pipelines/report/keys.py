"""The tables of a report's keys for the documents, made from the types and their comments."""

import dataclasses
import inspect
import re
import types
import typing
from collections.abc import Iterator, Mapping

import msgspec

from kontur_av.codecs.h264 import DecoderCounts
from kontur_av.streams.paced_sender import SenderCounts
from kontur_av.streams.video_receiver import VideoReceiverCounts
from kontur_av.streams.video_sender import FeedbackCounts
from kontur_av.streams.voice_receiver import VoiceReceiverCounts
from pipelines.hand.figures import WallFigures
from pipelines.link.figures import SocketFigures, WayInFigures
from pipelines.media.figures import (
    CaptureFigures,
    DisplayFigures,
    GainFigures,
    SelectorFigures,
    SnapshotFigures,
    StereoFigures,
)
from pipelines.mission.figures import ConsoleFigures, TaskFigures, TmtcFigures
from pipelines.partner.figures import RtcFigures
from pipelines.recording.figures import RecorderFigures
from pipelines.report.model import keys_of
from pipelines.seats.figures import PageFigures
from pipelines.session.figures import LoopFigures, ProbeFigures, TrainerFigures
from telepresence.haptics.figures import JoystickFigures, PortFigures, SamplesReceived, SamplesSent
from telepresence.haptics.ownership import OwnershipFigures
from telepresence.link.figures import GatewayFigures
from telepresence.link.peer.figures import PeerFigures

#: All records that processes tell.
TOLD: tuple[type, ...] = (
    ProbeFigures,
    LoopFigures,
    CaptureFigures,
    StereoFigures,
    SelectorFigures,
    SenderCounts,
    FeedbackCounts,
    GainFigures,
    VideoReceiverCounts,
    DecoderCounts,
    VoiceReceiverCounts,
    DisplayFigures,
    SnapshotFigures,
    GatewayFigures,
    SocketFigures,
    WayInFigures,
    PeerFigures,
    SamplesSent,
    SamplesReceived,
    PortFigures,
    WallFigures,
    JoystickFigures,
    OwnershipFigures,
    ConsoleFigures,
    TmtcFigures,
    TaskFigures,
    TrainerFigures,
    PageFigures,
    RtcFigures,
    RecorderFigures,
)
_UNITS = {
    "ns": "ns",
    "us": "µs",
    "ms": "ms",
    "s": "s",
    "bps": "bit/s",
    "hz": "1/s",
    "uj": "µJ",
    "octets": "octets",
    "percent": "%",
    "n": "N",
    "c": "°C",
    "mm": "mm",
    "km": "km",
    "deg": "°",
}
_WORDS: dict[object, str] = {int: "integer", float: "number", str: "text", bool: "true or false"}


def keys_tables(kind: type, *, without: type | None = None) -> str:
    """A table for `kind` and one for each type below it, in the order in which they come."""
    listed = [] if without is None else _types_below(without)
    parts = []
    for one in _types_below(kind):
        if one in listed:
            continue
        rows = ["| key | type | unit | what |", "|---|---|---|---|"]
        rows += [
            f"| `{key}` | {words} | {unit} | {what} |" for key, words, unit, what in _rows(one)
        ]
        parts.append(f"**{one.__name__}**: {_summary(one)}\n\n" + "\n".join(rows))
    return "\n\n".join(parts) + "\n"


def counts_table() -> str:
    """A table of all that processes count and tell, by the names that it has in a report."""
    rows = ["| of | figure | type | unit | what |", "|---|---|---|---|---|"]
    for kind in TOLD:
        of, stream = _summary(kind), "STREAM." if kind is DisplayFigures else ""
        for key, words, unit, what in _rows(kind):
            rows.append(f"| {of} | `{stream}{key}` | {words} | {unit} | {what} |")
            of = ""
    return "\n".join(rows) + "\n"


def _summary(kind: type) -> str:
    return (inspect.getdoc(kind) or "").splitlines()[0]


def comments(kind: type) -> dict[str, str]:
    """By field: the `#:` comment above it, those of base classes included."""
    found: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        if not _is_record(base):
            continue
        above: list[str] = []
        for line in inspect.getsource(base).splitlines():
            text = line.strip()
            if text.startswith("#: "):
                above.append(text.removeprefix("#: "))
            elif match := re.match(r"(\w+): ", text):
                found[match[1]] = " ".join(above)
                above = []
            else:
                above = []
    return found


def _rows(kind: type) -> Iterator[tuple[str, str, str, str]]:
    """Key, type, unit and sentence of each field, those of flat records in its place."""
    texts, hints = comments(kind), typing.get_type_hints(kind)
    for name, key, optional, flat in keys_of(kind):
        below = list(_records(hints[name]))
        if flat:
            for record in below:
                yield from _rows(record)
            continue
        words = _words(hints[name], optional=optional)
        yield key, words + (", optional" if optional else ""), _unit(name), texts.get(name, "")


def _unit(name: str) -> str:
    """The unit at the end of a name; the name of a rate may have one more word after it."""
    if name == "seconds":
        return "s"
    words = name.split("_")
    if "bps" in words:
        return _UNITS["bps"]
    return _UNITS.get(words[-1], "") if len(words) > 1 else ""


def _words(hint: object, *, optional: bool = False) -> str:
    """A type in words."""
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin in (types.UnionType, typing.Union):
        one = next(of for of in arguments if of is not type(None))
        return _words(one) + ("" if optional else " or null")
    if origin in (dict, Mapping):
        return f"{_words(arguments[1])}, by name"
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
    if isinstance(hint, type) and _is_record(hint):
        yield hint
    for argument in typing.get_args(hint):
        yield from _records(argument)


def _is_record(kind: type) -> bool:
    return dataclasses.is_dataclass(kind) or (
        issubclass(kind, msgspec.Struct) and kind is not msgspec.Struct
    )
