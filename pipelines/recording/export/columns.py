"""Messages of a recording as columns of a table. A core.

Every channel is a table, every message a row; of haptic samples and transfer frames, each sample
and frame. A column is an array of numbers or a list of texts. Its name has its unit.
"""

from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from math import isnan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ProtocolError
from pipelines.hand.haptic_trace import ACTED, CONTACT, DEAD_MAN
from pipelines.recording import recorded_messages as messages
from pipelines.recording.joined import FAR_NS, JoinedMessage
from pipelines.recording.schemas import TIMESTAMP, MessageSchema

#: Numbers of any type, (rows,), or a text for each row.
Column = NDArray[Any] | list[str]
Columns = dict[str, Column]
#: What a message adds to each column.
Rows = Mapping[str, Sequence[Any] | NDArray[Any]]
_NewRows = dict[str, Sequence[Any] | NDArray[Any]]

_TYPES = {
    "bool": np.bool_,
    "fixed32": np.uint32,
    "double": np.float64,
    "float": np.float32,
    "int64": np.int64,
    "sfixed32": np.int32,
    "sfixed64": np.int64,
    "uint32": np.uint32,
    "uint64": np.uint64,
    "Level": np.int32,
}
_BY_NAME = {schema.full_name: schema for schema in messages.SCHEMAS}
#: Fields that are the row's instant already.
_INSTANTS = {"session_ns", "capture_ns", "timestamp"}
#: What MATLAB's `namelengthmax` and `iskeyword` say.
_LONGEST_NAME = 63
_KEYWORDS = (
    " break case catch classdef continue else elseif end for function global if otherwise parfor "
    "persistent return spmd switch try while "
)
_STATE_BIT, _STATES, _LIT_BIT, _LIT = 8, 0xF, 16, 0xFF


class Columnizer:
    """Turns messages into rows.

    begin_ns: the instant on the session's clock at which `time_s` is 0.
    unreadable: messages that are not of their schema, by channel.
    """

    def __init__(self, begin_ns: int) -> None:
        self.unreadable: dict[str, int] = {}
        self._begin_ns = begin_ns

    def rows(self, message: JoinedMessage) -> Rows | None:
        """Return what a message adds; None for a schema that this version does not know."""
        schema = _BY_NAME.get(message.schema)
        if schema is None:
            return None
        special = _SPECIAL.get(schema.full_name)
        try:
            read = _one_row if special is None else special
            instants, rows = read(message)
            session_ns = _near(np.asarray(instants, np.int64), message.session_ns)
        except (ProtocolError, OverflowError):
            # OverflowError: an instant beyond 64 bits.
            self.unreadable[message.topic] = self.unreadable.get(message.topic, 0) + 1
            return None
        time_s = (session_ns - self._begin_ns) / NS_PER_S
        return {"time_s": time_s, "session_ns": session_ns, **rows}

    def lines(self) -> list[str]:
        """What could not be read, in words."""
        return [
            f"{topic}: {count} messages are not of their schema, and were left out"
            for topic, count in self.unreadable.items()
        ]


def _near(instants_ns: NDArray[np.int64], message_ns: int) -> NDArray[np.int64]:
    """Move instants within a message that are far from its own between those that are not."""
    right = np.abs(instants_ns - message_ns) <= FAR_NS
    if right.all():
        return instants_ns
    if not right.any():
        moved_ns: NDArray[np.int64] = instants_ns - instants_ns[0] + message_ns
        return moved_ns
    rows = np.arange(len(instants_ns))
    since_ns = np.interp(rows, rows[right], instants_ns[right] - message_ns)
    return np.where(right, instants_ns, message_ns + since_ns.astype(np.int64))


def joined(blocks: Iterable[Rows]) -> Columns:
    """Return the columns of many rows, in order.

    A column that a block lacks is 0, False or "" there: a figure that was not counted yet. A number
    of 64-bit floating point is NaN: a parameter that the report does not have.
    """
    blocks = list(blocks)
    names = list(dict.fromkeys(name for block in blocks for name in block))
    return {name: _joined_column(name, blocks) for name in names}


def _joined_column(name: str, blocks: Sequence[Rows]) -> Column:
    kind = next(block[name] for block in blocks if name in block)
    if isinstance(kind, np.ndarray):
        none = np.nan if kind.dtype == np.float64 else 0
        return np.concatenate(
            [
                block[name] if name in block else np.full(len(block["time_s"]), none, kind.dtype)
                for block in blocks
            ]
        )
    return [
        text
        for block in blocks
        for text in (block[name] if name in block else [""] * len(block["time_s"]))
    ]


def _one_row(message: JoinedMessage) -> tuple[list[int], Rows]:
    schema = _BY_NAME[message.schema]
    parsed = messages.parse_message(schema, message.data)
    session_ns = message.session_ns
    rows: _NewRows = {
        "published_ns": np.array([message.published_ns], np.int64),
        "message_number": np.array([message.sequence], np.uint32),
    }
    for row in schema.fields:
        value = getattr(parsed, row.name)
        if row.name == "session_ns":
            session_ns = value
        if row.name in _INSTANTS or row.type == TIMESTAMP:
            continue
        if row.repeated and row.type not in {each.name for each in schema.nested}:
            _add(rows, row.name, "string", " ".join(map(str, value)))
        elif row.repeated:
            rows |= _nested(schema, row.type, row.name, value)
        else:
            _add(rows, row.name, row.type, value, picture=schema.package == "foxglove")
    return [session_ns], rows


def _nested(schema: MessageSchema, kind: str, name: str, parts: Iterable[Any]) -> Rows:
    """Columns such as `carried_voice_octets`: of each part, named by its first field."""
    (inner,) = (each for each in schema.nested if each.name == kind)
    key, *fields = inner.fields
    rows: _NewRows = {}
    for part in parts:
        told = identifier(getattr(part, key.name))
        for row in fields:
            _add(rows, f"{name}_{told}_{row.name}", row.type, getattr(part, row.name))
    return rows


def _add(rows: _NewRows, name: str, kind: str, value: Any, *, picture: bool = False) -> None:
    if kind == "bytes" and picture:
        rows["octets"] = np.array([len(value)], np.uint32)
    elif kind == "bytes":
        rows[f"{name}_hex"] = [value.hex()]
    elif kind == "string":
        rows[name] = [value]
    else:
        rows[name] = np.array([value], _TYPES[kind])


def _haptics(message: JoinedMessage) -> tuple[NDArray[np.int64], Rows]:
    samples = messages.unpack_haptics(message.data)
    rows = {name: samples[name] for name in samples.dtype.names or () if name != "time_ns"}
    return samples["time_ns"], rows | flag_columns(samples["flags"])


def flag_columns(flags: NDArray[np.uint32]) -> dict[str, NDArray[Any]]:
    """The flags of haptic samples, as `haptic_trace.flags_of` packed them, each as a column."""
    return {
        "contact": (flags & CONTACT) != 0,
        "dead_man": (flags & DEAD_MAN) != 0,
        "passivity_acted": (flags & ACTED) != 0,
        "joystick_state": (flags >> _STATE_BIT & _STATES).astype(np.uint8),
        "lit_led": (flags >> _LIT_BIT & _LIT).astype(np.uint8),
    }


def _frames(message: JoinedMessage) -> tuple[Sequence[int], Rows]:
    frames = messages.unpack(messages.RecordedFrames, message.data)
    octets = np.array([len(data) for data in frames.data], np.uint32)
    return frames.time_ns, {"octets": octets, "data_hex": [data.hex() for data in frames.data]}


def _each_part(message: JoinedMessage) -> tuple[list[int], Rows]:
    schema = _BY_NAME[message.schema]
    (inner,) = schema.nested
    parsed = messages.parse_message(schema, message.data)
    parts = getattr(parsed, schema.fields[-1].name)
    rows: _NewRows = {}
    for row in inner.fields:
        values = [getattr(part, row.name) for part in parts]
        rows[row.name] = values if row.type == "string" else np.array(values, _TYPES[row.type])
    return [parsed.session_ns] * len(parts), rows


def _parameters(message: JoinedMessage) -> tuple[list[int], Rows]:
    """A column for each parameter: its name, with its unit behind it."""
    told = messages.unpack(messages.RecordedParameters, message.data)
    rows: _NewRows = {}
    for one in told.values:
        unit = identifier(one.unit.replace("%", "percent").replace("°", "deg")).strip("_")
        name = f"{one.name}_{unit}" if unit else one.name
        name = variable_name(name, rows)
        rows[name] = [one.text] if isnan(one.number) and one.text else np.array([one.number])
    return [told.session_ns], rows


_SPECIAL: Mapping[str, Callable[[JoinedMessage], tuple[Any, Rows]]] = {
    messages.HAPTIC_SAMPLES.full_name: _haptics,
    messages.TRANSFER_FRAMES.full_name: _frames,
    messages.LOSSES.full_name: _each_part,
    messages.METRICS.full_name: _each_part,
    messages.PARAMETERS.full_name: _parameters,
}


def identifier(text: str) -> str:
    """Return a text as a name: lower case, digits and underscores."""
    return "".join(sign if sign.isascii() and sign.isalnum() else "_" for sign in text).lower()


def table_names(topics: Iterable[str], taken: Iterable[str] = ()) -> dict[str, str]:
    """Return the name of each channel's table: `haptic_up_sent` for `/haptic/up/sent`.

    taken: names of others. Of channels whose names fall together, later ones get a number. Each is
    a name that MATLAB permits for variables.
    """
    names: dict[str, str] = {}
    used = {*taken}
    for topic in sorted(topics):
        names[topic] = name = variable_name(identifier(topic.strip("/")), used)
        used.add(name)
    return names


def variable_name(plain: str, used: Container[str]) -> str:
    """Return a name as MATLAB permits it for variables, with a number if it is in use."""
    if not plain[:1].isalpha() or f" {plain} " in _KEYWORDS:
        plain = f"x_{plain}"
    plain = name = plain[:_LONGEST_NAME]
    number = 2
    while name in used:
        ending = f"_{number}"
        name, number = plain[: _LONGEST_NAME - len(ending)] + ending, number + 1
    return name
