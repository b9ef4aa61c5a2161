"""A setup as a file has it. Its fields derive from those of `Setup`. A core.

In a file rates are in kbit/s, sizes are texts like "640x480", the radio is a name, and a link is
the length of its frames.
"""

from collections.abc import Iterator, Mapping
from dataclasses import MISSING, Field, dataclass, field, fields, make_dataclass, replace
from functools import cache
from types import UnionType
from typing import Any, Literal, get_args, get_origin

from kontur_av.clock import NS_PER_MS
from kontur_av.errors import ConfigError
from kontur_av.media import parse_size
from kontur_av.redaction import shown_spec
from pipelines.session.setup.table import RtcLeg, Setup, VideoStream, VoiceStream
from telepresence.link.profile import DOWNLINK, UPLINK, LinkProfile
from telepresence.link.radio.profile import RadioProfile

#: A frame lasts so long at most; a command is used for 10 ms at least.
MOST_SLOT_MS = 4


@dataclass(frozen=True, kw_only=True)
class _Link:
    frame_octets: int | None = None
    slot_ms: int = 1


@cache
def file_kind(kind: type) -> type[Any]:
    """The dataclass of what a file has for a `kind`."""
    rows = [_file_field(each, each.type) for each in fields(kind)]
    rows = [row for row in rows if row[0] != "height" and (row[0] != "name" or kind is Setup)]
    own = {"kind": kind}
    return make_dataclass(f"{kind.__name__}File", rows, frozen=True, kw_only=True, namespace=own)


def _file_field(of: Field[Any], hint: Any) -> tuple[str, Any, Any]:
    """Name, type and default of what a file has for a field."""
    name, default = of.name, of.default
    inner = get_args(hint)[0] if get_origin(hint) is UnionType else hint
    if name.endswith("_bps"):
        name, hint = name.replace("_bps", "_kbps"), float if hint is int else float | None
        default = default if default in (MISSING, None) else default / 1000
    elif name == "width":
        name, hint, default = "size", str, f"{VideoStream.width}x{VideoStream.height}"
    elif name == "coded":
        hint, default = str, "auto"
    elif inner is LinkProfile:
        hint, default = _Link, _Link()
    elif inner is RadioProfile or get_origin(hint) is Literal:
        hint = str
    elif inner in (VideoStream, VoiceStream, RtcLeg):
        hint = file_kind(inner) | None if default is None else file_kind(inner)
    kept: Any = {"default": default, "default_factory": of.default_factory}
    kept = {key: value for key, value in kept.items() if value is not MISSING}
    return name, hint, field(**kept, metadata=of.metadata)


#: What a setup's file holds; its fields are those of `Setup`.
SETUP_FILE = file_kind(Setup)


def setup_values(entry: Any, name: str = "") -> Mapping[str, Any]:
    """The fields of a setup, or of its table `name`, by its file's; the radio is still a name.

    Raises ConfigError for a malformed size.
    """
    values: dict[str, object] = {}
    for each in fields(entry):
        key, value = each.name, getattr(entry, each.name)
        if key.endswith("_kbps"):
            key, value = key.replace("_kbps", "_bps"), value and round(value * 1000)
        elif key == "size":
            values["width"], value = parse_size(value, f"{name}.size")
            key = "height"
        elif key == "coded":
            value = None if value == "auto" else parse_size(value, f"{name}.coded")
        elif isinstance(value, _Link):
            value = _profile(UPLINK if key == "uplink" else DOWNLINK, value, key)
        elif (kind := getattr(value, "kind", None)) is not None:
            own = {} if kind is RtcLeg else {"name": key}
            value = kind(**own, **setup_values(value, key))
        values[key] = value
    return values


def _profile(profile: LinkProfile, link: _Link, name: str) -> LinkProfile:
    octets = profile.frame_octets if link.frame_octets is None else link.frame_octets
    if not 1 <= link.slot_ms <= MOST_SLOT_MS:
        raise ConfigError(f"{name}.slot_ms is {link.slot_ms}: take 1 to {MOST_SLOT_MS}")
    # A longer frame has room for the standard's own pointer, and needs it.
    short = profile.pointer_in_vcid and octets <= profile.frame_octets
    slot_ns = link.slot_ms * NS_PER_MS
    return replace(profile, frame_octets=octets, slot_ns=slot_ns, pointer_in_vcid=short)


def setup_table(setup: Setup) -> Mapping[str, Any]:
    """Every field of a setup as its file has it, without passwords of sources.

    A radio that is not built in is only its name.
    """
    sources = {name: shown_spec(setup.source(name)) for name in setup.inputs}
    return {**_written(setup), "radio": setup.radio_profile.name, "sources": sources}


def _written(thing: Any) -> Mapping[str, Any]:
    table: dict[str, object] = {}
    for each in fields(thing):
        key, value = each.name, getattr(thing, each.name)
        if value is None or key == "height" or (key == "name" and not isinstance(thing, Setup)):
            continue
        if key == "width":
            key, value = "size", f"{thing.width}x{thing.height}"
        elif key == "coded":
            value = f"{value[0]}x{value[1]}"
        elif key.endswith("_bps"):
            key, value = key.replace("_bps", "_kbps"), value / 1000
        elif isinstance(value, LinkProfile):
            slot_ms = value.slot_ns // NS_PER_MS
            value = {"frame_octets": value.frame_octets} | (
                {} if slot_ms == 1 else {"slot_ms": slot_ms}
            )
        elif hasattr(value, "__dataclass_fields__"):
            value = _written(value)
        elif isinstance(value, Mapping):
            value = {
                name: _written(each) if hasattr(each, "__dataclass_fields__") else each
                for name, each in value.items()
            }
        table[key] = value
    return table


def setup_toml(setup: Setup) -> str:
    """Return a text that `setup_file` reads as this setup, with the radio's fields as a comment."""
    radio = f"# radio: {setup.radio_profile!r}".replace("\n", " ")
    table = setup_table(setup)
    plain = {key: value for key, value in table.items() if not isinstance(value, Mapping)}
    lines = [radio, *_lines(plain)]
    for key, value in table.items():
        if value and isinstance(value, Mapping):
            lines += [f"\n[{key}]", *_lines(value)]
    return "\n".join([*lines, ""])


def _lines(table: Mapping[str, Any]) -> Iterator[str]:
    for key, value in table.items():
        yield f"{key if key.isidentifier() and key.isascii() else _toml(key)} = {_toml(value)}"


def _toml(value: object) -> str:
    if isinstance(value, Mapping):
        return f"{{{', '.join(_lines(value))}}}"
    if isinstance(value, tuple):
        return f"[{', '.join(map(_toml, value))}]"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, Mapping):
        return f"{{{', '.join(_lines(value))}}}"
    if not isinstance(value, str):
        return repr(value)
    escaped = value.replace("\\", "\\\\").replace('"', '\\"')
    return '"' + "".join(c if c.isprintable() else f"\\U{ord(c):08x}" for c in escaped) + '"'
