"""The JSON Schema of a session's report, made from its types and their comments.

JSON Schema 2020-12. `$defs` has one schema for each record, by the name of its type. The keys of a
flat record stand in the schema of the record that holds it, as they do in the JSON.
"""

import dataclasses
import inspect
import re
import typing
from collections.abc import Mapping
from enum import Enum
from functools import cache
from types import UnionType
from typing import Any

import msgspec

from pipelines.report.model import keys_of
from pipelines.report.result import Json

Table = dict[str, Json]
_PLAIN = {int: "integer", float: "number", str: "string", bool: "boolean", type(None): "null"}


def schema_of(kind: type) -> Table:
    """The schema of a report of this kind, such as `SessionReport`."""
    defs: Table = {}
    _add(kind, defs)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": kind.__name__,
        "$ref": f"#/$defs/{kind.__name__}",
        "$defs": defs,
    }


def is_record(kind: object) -> bool:
    """Whether a type is a record of figures: a dataclass or a struct."""
    return isinstance(kind, type) and (
        dataclasses.is_dataclass(kind)
        or (issubclass(kind, msgspec.Struct) and kind is not msgspec.Struct)
    )


@cache
def comments(kind: type) -> Mapping[str, str]:
    """By field: the `#:` comment above it, those of base classes included."""
    found: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        if not is_record(base):
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


def _add(kind: type, defs: Table) -> None:
    if kind.__name__ in defs:
        return
    schema: Table = {}
    defs[kind.__name__] = schema
    properties, required, open_ended = _properties(kind, defs)
    schema |= {
        "description": (inspect.getdoc(kind) or "").partition("\n")[0],
        "type": "object",
        "properties": properties,
        "required": list(required),
    }
    if not open_ended:
        schema["additionalProperties"] = False


def _properties(kind: type, defs: Table) -> tuple[Table, list[str], bool]:
    """The keys of a record with their schemas, those that are always there, and whether others
    may be there.
    """
    hints, said = typing.get_type_hints(kind), comments(kind)
    properties: Table = {}
    required: list[str] = []
    open_ended = False
    for name, key, optional, flat in keys_of(kind):
        if not flat:
            told, hint = said.get(name), _present(hints[name]) if optional else hints[name]
            schema: Table = {"description": told} if told else {}
            properties[key] = schema | _schema(hint, defs)
            required += [] if optional else [key]
            continue
        record = _present(hints[name])
        if not is_record(record):
            open_ended = True
            continue
        inner, needed, _ = _properties(record, defs)
        for below, one in inner.items():
            properties[below] = _either(properties.get(below), one)
        required += [] if optional else needed
    return properties, required, open_ended


def _either(one: Json, other: Json) -> Json:
    """The schema of a key that two records have, of which one is there at a time."""
    return other if one is None or one == other else {"anyOf": [one, other]}


def _present(hint: Any) -> Any:
    """The type without None: a key without a value is left out."""
    return next((one for one in _alternatives(hint) if one is not type(None)), hint)


def _alternatives(hint: object) -> tuple[Any, ...]:
    union = typing.get_origin(hint) in (UnionType, typing.Union)
    return typing.get_args(hint) if union else ()


def _schema(hint: Any, defs: Table) -> Table:
    if hint in _PLAIN:
        return {"type": _PLAIN[hint]}
    if alternatives := _alternatives(hint):
        return {"anyOf": [_schema(one, defs) for one in alternatives]}
    if is_record(hint):
        _add(hint, defs)
        return {"$ref": f"#/$defs/{hint.__name__}"}
    if isinstance(hint, type) and issubclass(hint, Enum):
        return {"enum": [one.value for one in hint]}
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin in (dict, Mapping):
        return {"type": "object", "additionalProperties": _schema(arguments[1], defs)}
    if origin is list or Ellipsis in arguments:
        return {"type": "array", "items": _schema(arguments[0], defs)}
    if origin is tuple:
        return {
            "type": "array",
            "prefixItems": [_schema(one, defs) for one in arguments],
            "minItems": len(arguments),
            "maxItems": len(arguments),
        }
    # A typed table.
    rows = typing.get_type_hints(hint)
    return {
        "type": "object",
        "properties": {name: _schema(one, defs) for name, one in rows.items()},
        "required": list(rows),
    }
