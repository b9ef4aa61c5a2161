"""The tables of a recording for MATLAB: haptics of a direction in one, all else beside. A core.

Row numbers count from 1, as in MATLAB. NaN stands for none.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kontur_av.clock import NS_PER_MS, NS_PER_S, NS_PER_US
from pipelines.recording import messages
from pipelines.recording.channels import EVENTS, RECEIVED, SENT
from pipelines.recording.export.columns import (
    Column,
    Columnizer,
    Columns,
    Rows,
    joined,
    table_names,
)
from pipelines.recording.joined import JoinedMessage

#: An event belongs to the newest haptic cycle that is not older than this.
NEAR_NS = 20 * NS_PER_MS
#: Sample numbers have 16 bits, so at 1 kHz one comes again after 65 s. No link delays that long.
_MOST_DELAY_NS = 30 * NS_PER_S
#: Bits of an instant in µs beside the number of a sample: two years.
_INSTANT_BITS = 46
#: The variable that says where the tables come from.
RECORDING = "recording"
_HAPTIC, _FACTS = "/haptic/", "/facts"
_LEFT_OUT = {messages.LOG.full_name, messages.TRANSFER_FRAMES.full_name}

Tables = dict[str, Columns]


class TableCollector:
    """Collects a recording's tables; then call `tables`.

    begin_ns: the instant on the session's clock at which `time_s` is 0.
    """

    def __init__(self, begin_ns: int) -> None:
        self.columnizer = Columnizer(begin_ns)
        self._begin_ns = begin_ns
        self._rows: dict[str, list[Rows]] = {}
        self._schemas: dict[str, str] = {}

    def handle_message(self, message: JoinedMessage) -> None:
        """Take the next message. Transfer frames and lines of the log have no table."""
        if message.schema in _LEFT_OUT:
            return
        rows = self.columnizer.rows(message)
        if rows is not None:
            self._schemas[message.topic] = message.schema
            self._rows.setdefault(message.topic, []).append(rows)

    def tables(self) -> Tables:
        """Return the tables by name, each with its rows in the order of their instants.

        haptic_up, haptic_down: as `haptic_tables`. events; commands: telecommands and telemetry, as
        sent and as received; both with the rows of the haptic tables in which they happened. Other
        tables have the name of their channel. Where a channel has facts, they are its table.
        """
        found = {topic: in_order(joined(rows)) for topic, rows in self._rows.items()}
        self._rows.clear()
        tables: Tables = {}
        haptics = haptic_tables(
            self._taken(found, messages.HAPTIC_SAMPLES.full_name), self._begin_ns
        )
        packets = self._taken(found, messages.SPACE_PACKET.full_name)
        tables |= haptics
        if EVENTS in found:
            events = found.pop(EVENTS)
            tables["events"] = events | rows_of_haptics(events, haptics)
        if packets:
            commands = _commands(packets)
            tables["commands"] = commands | rows_of_haptics(commands, haptics)
        pictures = {topic for topic in found if self._schemas[topic] == messages.VIDEO.full_name}
        shown = {
            base if (base := topic.removesuffix(_FACTS)) in pictures else topic: columns
            for topic, columns in found.items()
            if topic not in pictures or f"{topic}{_FACTS}" not in found
        }
        names = table_names(shown, taken=[*tables, RECORDING])
        return tables | {names[topic]: columns for topic, columns in shown.items()}

    def _taken(self, found: Tables, schema: str) -> Tables:
        topics = [topic for topic in found if self._schemas[topic] == schema]
        return {topic: found.pop(topic) for topic in topics}


def in_order(columns: Columns) -> Columns:
    """Return the rows sorted by their instants; rows of one instant stay in their order."""
    order = np.argsort(_numbers(columns["session_ns"]), kind="stable")
    return {
        name: column[order] if isinstance(column, np.ndarray) else [column[at] for at in order]
        for name, column in columns.items()
    }


def haptic_tables(channels: Mapping[str, Columns], begin_ns: int) -> Tables:
    """Return a table for each direction: the cycles of the end that sends in it.

    channels: by topic, in the order of their instants. Beside what is in the channel:
    acted_on: the number of the sample of the other direction on which the end acted; -1: none.
    received_s: when the other end first acted on the sample of this cycle; NaN: never.
    delay_s: the same, since this cycle.
    """
    tables: Tables = {}
    for key, other in (("up", "down"), ("down", "up")):
        sent = channels.get(f"{_HAPTIC}{key}/{SENT}")
        if sent is None:
            continue
        received_ns = _received_ns(sent, channels.get(f"{_HAPTIC}{key}/{RECEIVED}"))
        own_ns = _numbers(sent["session_ns"])
        never = received_ns < 0
        acted_on = _acted_on(own_ns, channels.get(f"{_HAPTIC}{other}/{RECEIVED}"))
        tables[f"haptic_{key}"] = sent | {
            "acted_on": acted_on,
            "received_s": np.where(never, np.nan, (received_ns - begin_ns) / NS_PER_S),
            "delay_s": np.where(never, np.nan, (received_ns - own_ns) / NS_PER_S),
        }
    return tables


def _received_ns(sent: Columns, received: Columns | None) -> NDArray[np.int64]:
    """When each sample was first acted on, session clock; -1: never."""
    sent_ns = _numbers(sent["session_ns"])
    found = np.full(len(sent_ns), -1, np.int64)
    if received is None or not len(sent_ns):
        return found
    received_ns = _numbers(received["session_ns"])
    order, keys = _keys(sent, sent_ns[0])
    _, wanted = _keys(received, sent_ns[0], ordered=False)
    # The newest sample of this number that is not younger than the cycle that acted on it.
    place = np.searchsorted(keys, wanted, side="right") - 1
    row = order[np.maximum(place, 0)]
    right = (
        (place >= 0)
        & (_numbers(received["sequence"]) != messages.NO_SAMPLE)
        & (_numbers(sent["sequence"])[row] == _numbers(received["sequence"]))
        & (received_ns - sent_ns[row] < _MOST_DELAY_NS)
    )
    rows, first = np.unique(row[right], return_index=True)
    found[rows] = received_ns[right][first]
    return found


def _keys(
    columns: Columns, origin_ns: int, *, ordered: bool = True
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Integers that sort by the number of the sample first, by the instant in µs then."""
    instants = (_numbers(columns["session_ns"]) - origin_ns) // NS_PER_US
    keys = (_numbers(columns["sequence"]).astype(np.int64) << _INSTANT_BITS) + instants
    order = np.argsort(keys, kind="stable") if ordered else np.arange(len(keys))
    return order, keys[order]


def _acted_on(own_ns: NDArray[np.int64], received: Columns | None) -> NDArray[np.int32]:
    """The number of the sample on which an end acted in each of its cycles."""
    found = np.full(len(own_ns), messages.NO_SAMPLE, np.int32)
    if received is not None and len(received["session_ns"]):
        cycles = _numbers(received["session_ns"])
        place = np.minimum(np.searchsorted(cycles, own_ns), len(cycles) - 1)
        same = cycles[place] == own_ns
        found[same] = _numbers(received["sequence"])[place[same]]
    return found


def rows_of_haptics(columns: Columns, haptics: Tables) -> Columns:
    """Return, for each instant, the row of each haptic table in which it lies, from 1.

    That is the newest cycle that is not younger. NaN where it is older than `NEAR_NS`, or there is
    none.
    """
    instants = _numbers(columns["session_ns"])
    found: Columns = {}
    for name, table in haptics.items():
        cycles = _numbers(table["session_ns"])
        rows = np.searchsorted(cycles, instants, side="right")
        near = rows > 0
        near[near] = instants[near] - cycles[rows[near] - 1] <= NEAR_NS
        found[f"{name}_row"] = np.where(near, rows, np.nan)
    return found


def _commands(packets: Tables) -> Columns:
    """Telecommands and telemetry in one table; kind, end and way say which is which."""
    blocks = []
    for topic, columns in packets.items():
        kind, end, way = _packet_topic(topic)
        count = len(columns["session_ns"])
        told = {"kind": [kind] * count, "end": [end] * count, "way": [way] * count}
        blocks.append({**columns, **told})
    return in_order(joined(blocks))


def _packet_topic(topic: str) -> tuple[str, str, str]:
    """Kind, end and way. Older recordings have no end: telecommands went down, telemetry up."""
    kind, *end, way = topic.strip("/").split("/")
    above = (kind == "telecommand") == (way == SENT)
    return kind, end[0] if end else "space" if above else "ground", way


def _numbers(column: Column) -> NDArray[Any]:
    assert isinstance(column, np.ndarray)
    return column
