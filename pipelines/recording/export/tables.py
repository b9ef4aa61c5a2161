"""Tables of a recording: haptics of a direction, all else beside; rows of a constant rate. A core.

Row numbers for MATLAB count from 1; NaN stands for none. Row i of an episode lies i / fps behind
the capture of its first picture.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kontur_av.clock import NS_PER_MS, NS_PER_S, NS_PER_US
from kontur_av.errors import ProtocolError
from pipelines.recording import recorded_messages as messages
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
from pipelines.recording.recorded_messages import RecordedPacket, unpack
from pipelines.session.topology.streams import TELECOMMAND, TELEMETRY
from telepresence.tmtc.k2aci import Numbered, StartTask, TaskFinished, parse_body
from telepresence.tmtc.pus.node import K2ACI_SERVICE
from telepresence.tmtc.pus.packets import parse_packet

#: An event belongs to the newest haptic cycle that is not older than this.
NEAR_NS = 20 * NS_PER_MS
#: Sample numbers have 16 bits, so at 1 kHz one comes again after 65 s. No link delays that long.
_MOST_DELAY_NS = 30 * NS_PER_S
#: Bits of an instant in µs beside the number of a sample: two years.
_INSTANT_BITS = 46
#: The variable that says where the tables come from.
RECORDING = "recording"
_HAPTIC, _METADATA = "/haptic/", "/facts"
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
            base if (base := topic.removesuffix(_METADATA)) in pictures else topic: columns
            for topic, columns in found.items()
            if topic not in pictures or f"{topic}{_METADATA}" not in found
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


class Placed(NamedTuple):
    """The picture of each row, by its number; -1 before the first.

    own: (rows,), the picture was captured for this row; else it is the one before, repeated.
    left_out: pictures that a newer one of the same row replaced.
    """

    pictures: NDArray[np.int64]
    own: NDArray[np.bool_]
    left_out: int


def row_instants(first_ns: int, end_ns: int, fps: int) -> NDArray[np.int64]:
    """Return the instants of an episode's rows; a row whose instant is after `end_ns` is none."""
    count = max((end_ns - first_ns) * fps // NS_PER_S + 1, 0)
    return first_ns + np.arange(count, dtype=np.int64) * NS_PER_S // fps


def place_pictures(
    captures_ns: NDArray[np.int64], instants_ns: NDArray[np.int64], fps: int
) -> Placed:
    """Each picture stands in the row nearest to its capture. Of several, the newest stays.

    A row without one repeats the picture before it. captures_ns: rising.
    """
    count = len(instants_ns)
    slots = np.rint((captures_ns - instants_ns[0]) * (fps / NS_PER_S)).astype(np.int64)
    pictures = np.full(count, -1, np.int64)
    inside = np.flatnonzero((slots >= 0) & (slots < count))
    # Of several places that are equal, NumPy keeps the last value.
    pictures[slots[inside]] = inside
    own = pictures >= 0
    before = int(np.searchsorted(slots, 0)) - 1
    pictures = np.maximum.accumulate(np.maximum(pictures, before))
    return Placed(pictures, own, len(inside) - int(own.sum()))


def usual_fps(captures_ns: NDArray[np.int64]) -> int:
    """Return the rate of pictures, in whole ones a second, by their median distance."""
    if len(captures_ns) < 2:
        return 1
    return max(round(NS_PER_S / float(np.median(np.diff(captures_ns)))), 1)


class Run(NamedTuple):
    """A run of a task. end_ns: None if the recording ended before."""

    task: str
    begin_ns: int
    end_ns: int | None
    result: str


#: First the channels of the robot, which receives telecommands and sends telemetry.
_STARTS = (f"/{TELECOMMAND}/{RECEIVED}", f"/{TELECOMMAND}/{SENT}")
_ENDS = (f"/{TELEMETRY}/{SENT}", f"/{TELEMETRY}/{RECEIVED}")
#: The channels that `TaskRuns` takes.
TASK_CHANNELS = frozenset((*_STARTS, *_ENDS))


class TaskRuns:
    """Finds the runs of tasks in recorded packets: from `StartTask` to `TaskFinished`.

    At the robot if its packets are in the recording, else at the joystick.
    """

    def __init__(self) -> None:
        self._told: dict[tuple[str, int, str], tuple[int, StartTask | TaskFinished]] = {}

    def handle_message(self, message: JoinedMessage) -> None:
        """Take a packet of `TASK_CHANNELS`. Others than those of tasks are ignored."""
        try:
            recorded = unpack(RecordedPacket, message.data)
            packet = parse_packet(recorded.data)
            body = parse_body(packet.data) if packet.service == K2ACI_SERVICE else None
        except ProtocolError:
            return
        if isinstance(body, Numbered) and isinstance(body.message, StartTask | TaskFinished):
            found = body.message
            # The first one: others are repetitions.
            key = (message.topic, found.run, found.task)
            self._told.setdefault(key, (recorded.session_ns, found))

    def runs(self) -> list[Run]:
        starts, ends = self._of(_STARTS, StartTask), self._of(_ENDS, TaskFinished)
        found = []
        for key, (begin_ns, _) in starts.items():
            end_ns, end = ends.get(key, (None, None))
            result = str(end.result) if isinstance(end, TaskFinished) else "unfinished"
            found.append(Run(key[1], begin_ns, end_ns, result))
        return sorted(found, key=lambda run: run.begin_ns)

    def _of(
        self, channels: Sequence[str], kind: type[StartTask] | type[TaskFinished]
    ) -> dict[tuple[int, str], tuple[int, StartTask | TaskFinished]]:
        for channel in channels:
            found = {
                (run, task): told
                for (topic, run, task), told in self._told.items()
                if topic == channel and isinstance(told[1], kind)
            }
            if found:
                return found
        return {}
