"""The tables of a report's keys for the documents, made from the types and their comments."""

import dataclasses
import inspect
import itertools
import re
import types
import typing
from collections.abc import Iterable, Iterator, Mapping

import msgspec

from pipelines.session import figures

#: By counter that is a table: what its keys are.
_KEYS = {
    "strangers": "_PORT",
    "refused": "_REASON",
    "samples": "_FATE",
    **dict.fromkeys(("kept", "missed", "dropped"), "_CHANNEL"),
    **dict.fromkeys(
        (
            "packets",
            "octets",
            "packets_lost",
            "packets_asked",
            "packets_repeated",
            "keys_asked",
        ),
        "_STREAM",
    ),
}
_WORDS: dict[object, str] = {int: "integer", float: "number", str: "text", bool: "true or false"}


def keys_tables(kind: type, *, without: type | None = None) -> str:
    """A list for `kind` and one for each type below it, in the order in which they come."""
    listed = [] if without is None else _types_below(without)
    parts = []
    for one in _types_below(kind):
        if one in listed:
            continue
        rows = _listed(_rows(one))
        summary = inspect.getdoc(one) or ""
        parts.append(f"**{one.__name__}**: {summary.splitlines()[0]}\n\n" + "\n".join(rows))
    return "\n\n".join(parts) + "\n"


def counters_table() -> str:
    """Lists of all counters, by the names that they have in a report."""
    parts = []
    for kind in vars(figures).values():
        if not isinstance(kind, type) or kind.__base__ is not figures.Counters:
            continue
        described, of = comments(kind), (inspect.getdoc(kind) or "").splitlines()[0]
        prefix = "STREAM." if kind is figures.DisplayCounters else ""
        rows = _listed(
            (
                f"`{prefix}{name}{_KEYS[name] if typing.get_origin(hint) is Mapping else ''}`",
                described[name],
            )
            for name, hint in typing.get_type_hints(kind).items()
        )
        parts.append(f"**{of}**\n\n" + "\n".join(rows))
    return "\n\n".join(parts) + "\n"


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


def _listed(rows: Iterable[tuple[str, str]]) -> list[str]:
    """Items of (key, comment); keys without a comment share an item with their neighbours."""
    items = []
    for what, alike in itertools.groupby(rows, key=lambda row: row[1]):
        keys = [key for key, _ in alike]
        items += [f"- {key}: {what}" for key in keys] if what else [f"- {', '.join(keys)}"]
    return items


def _rows(kind: type) -> Iterator[tuple[str, str]]:
    """Each key with its type, unless it is an integer, and its comment; `?`: may be absent."""
    texts, hints = comments(kind), typing.get_type_hints(kind)
    for name, key, optional in _fields(kind):
        words = _words(hints[name], optional=optional)
        told = f"`{key}`" + "?" * optional
        yield told if words == _WORDS[int] else f"{told} ({words})", texts.get(name, "")


def _fields(kind: type) -> Iterator[tuple[str, str, bool]]:
    """The name, the key in JSON, and whether it may be absent, of each field."""
    if issubclass(kind, msgspec.Struct):
        for field in msgspec.structs.fields(kind):
            yield field.name, field.encode_name, not field.required
    elif dataclasses.is_dataclass(kind):
        for plain in dataclasses.fields(kind):
            yield plain.name, plain.name, False


def _words(hint: object, *, optional: bool = False) -> str:
    """A type in words."""
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin in (types.UnionType, typing.Union):
        one = next(of for of in arguments if of is not type(None))
        return _words(one) + ("" if optional else " or null")
    if origin is dict:
        return f"{_words(arguments[1])}, by name"
    if origin is list:
        return f"list of {_words(arguments[0])}"
    if origin is tuple:
        return f"[{', '.join(map(_words, arguments))}]"
    return _WORDS.get(hint, getattr(hint, "__name__", str(hint)))


def _types_below(kind: type) -> list[type]:
    found = [kind]
    for one in found:
        for hint in typing.get_type_hints(one).values():
            found += [below for below in _records(hint) if below not in found]
    return found


def _records(hint: object) -> Iterator[type]:
    if isinstance(hint, type) and _is_record(hint):
        yield hint
    for argument in typing.get_args(hint):
        yield from _records(argument)


def _is_record(kind: type) -> bool:
    return dataclasses.is_dataclass(kind) or (
        issubclass(kind, msgspec.Struct) and kind is not msgspec.Struct
    )
