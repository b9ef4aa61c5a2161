"""The protobuf schemas of a recording, made of its records (`messages`). A core.

Those of the package `foxglove` are the public ones (https://docs.foxglove.dev/docs/sdk/schemas), so
that other tools show pictures, sound and log. Those of `kontur_av` are this project's own. A field
of these is only ever added: neither its number nor its meaning changes.

Instants within messages of `kontur_av` are on the session's clock. `timestamp` of those of
`foxglove` is wall time, as the `log_time` of every message is.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from functools import cache
from typing import (
    Annotated,
    Any,
    ClassVar,
    TypeVar,
    dataclass_transform,
    get_args,
    get_origin,
    get_type_hints,
)

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2

TIMESTAMP = "google.protobuf.Timestamp"
OWN, FOXGLOVE = "kontur_av", "foxglove"
T = TypeVar("T")

_Proto = descriptor_pb2.FieldDescriptorProto
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


def numbered(*rows: tuple[str, str, str]) -> tuple[FieldRow, ...]:
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


#: Types of the fields of a record: what Python holds, and its protobuf type.
Bool = Annotated[bool, "bool"]
Double = Annotated[float, "double"]
Fixed32 = Annotated[int, "fixed32"]
Int64 = Annotated[int, "int64"]
Level = Annotated[int, "Level"]
Octets = Annotated[bytes, "bytes"]
Sfixed64 = Annotated[int, "sfixed64"]
Text = Annotated[str, "string"]
Uint32 = Annotated[int, "uint32"]
Uint64 = Annotated[int, "uint64"]
WallTime = Annotated[int, TIMESTAMP]


@dataclass_transform(frozen_default=True, kw_only_default=True)
def record(
    name: str, what: str = "", *, package: str = OWN, levels: type[Enum] | None = None
) -> Callable[[type[T]], type[T]]:
    """Make a frozen dataclass of a class, and its schema of its fields, in their order.

    A field is `Annotated[type, meaning]`. `wall_ns` is the schema's `timestamp`. A field of
    `Sequence[record]` holds nested messages; `parts` has their classes by name.
    """

    def made(kind: type[T]) -> type[T]:
        made: Any = dataclass(frozen=True, slots=True, kw_only=True)(kind)
        rows: list[tuple[str, str, str]] = []
        made.parts = {}
        for field, hint in get_type_hints(kind, include_extras=True).items():
            if get_origin(hint) is ClassVar:
                continue
            *types, meaning = hint.__metadata__
            if not types:
                (item,) = get_args(hint.__origin__)
                if hasattr(item, "schema"):
                    made.parts[item.schema.name] = item
                    types = [f"{item.schema.name}[]"]
                else:
                    types = [f"{item.__metadata__[0]}[]"]
            rows.append((types[0], field.replace("wall_ns", "timestamp"), meaning))
        made.schema = MessageSchema(
            package=package,
            name=name,
            what=what,
            fields=numbered(*rows),
            nested=tuple(part.schema for part in made.parts.values()),
            levels=tuple(levels.__members__) if levels else (),
        )
        return made  # type: ignore[no-any-return]

    return made


def descriptor_set(schema: MessageSchema) -> bytes:
    """Return the schema as MCAP wants it: a serialised `FileDescriptorSet` with its imports."""
    files = [_timestamp_file()] if _is_dated(schema) else []
    found = descriptor_pb2.FileDescriptorSet(file=[*files, _file(schema)])
    return bytes(found.SerializeToString(deterministic=True))


@cache
def message_class(schema: MessageSchema) -> Any:
    """Return protobuf's class of its messages.

    Each has a pool of its own, in which no library can have another schema of the same name.
    """
    pool = descriptor_pool.DescriptorPool()
    for file in (_timestamp_file(), _file(schema)):
        pool.AddSerializedFile(file.SerializeToString())
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.full_name))


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
    if row.type == "Level":
        field.type, field.type_name = _Proto.TYPE_ENUM, f"{scope}.Level"
    elif row.type == TIMESTAMP:
        field.type, field.type_name = _Proto.TYPE_MESSAGE, f".{TIMESTAMP}"
    elif any(row.type == inner.name for inner in schema.nested):
        field.type, field.type_name = _Proto.TYPE_MESSAGE, f"{scope}.{row.type}"
    else:
        field.type = _Proto.Type.Value(f"TYPE_{row.type.upper()}")
    return field
