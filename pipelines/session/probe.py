"""What a process collects of its figures, and the message in which they go to the launcher. A core.

A process sends its figures twice a second, in one datagram. So a process that is killed loses only
the figures of its last half second.
"""

from __future__ import annotations

import pickle
from array import array
from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import chain
from typing import Any, Generic, TypeVar

from kontur_av.clock import NS_PER_MS
from pipelines.session.session_metrics import ProbeMetrics, Row
from pipelines.session.session_switch import Order, ProcessOrder

FLUSH_NS = 500 * NS_PER_MS
_MAX_SERIES_VALUES = 20_000

RowT = TypeVar("RowT", bound=Row)


class Series(Generic[RowT]):
    """The rows of one type that a process collects, flattened to 64-bit integers.

    kind: the type of the rows. stream: the stream that they are about; "" if the process alone
    says that. values: all rows, one value after the other.
    """

    __slots__ = ("kind", "stream", "values", "width")

    def __init__(self, kind: type[RowT], stream: str = "", values: array[int] | None = None):
        self.kind = kind
        self.stream = stream
        self.values = array("q") if values is None else values
        self.width = len(kind._fields)

    def add(self, row: RowT) -> None:
        self.values.extend(row)

    def extend(self, rows: Iterable[tuple[int, ...]]) -> None:
        """Add rows with the columns of `kind`; plain ones, too, which cost a 1 kHz loop less."""
        self.values.extend(chain.from_iterable(rows))

    def extend_column(self, values: Iterable[int]) -> None:
        """Add rows of a single value each. Raises ValueError if `kind` has more columns."""
        if self.width != 1:
            raise ValueError(f"a {self.kind.__name__} has {self.width} values, not one")
        self.values.extend(values)

    def rows(self) -> list[RowT]:
        columns = [iter(self.values)] * self.width
        return [self.kind(*row) for row in zip(*columns, strict=True)]


@dataclass(slots=True)
class Message:
    """One message of one process.

    metrics: records of what was counted, one of each kind; of each stream for those that are about
        streams.
    series: single events, such as packets, in the order in which their series were begun.
    scheduler: `fifo` with real-time priority, `other` without the permission for it, `too_busy` if
        it gave it up because it took more than half a core; "" for a process that asks for none.
    last_error: why the process ends; "" while it runs.
    orders: what ground control ordered on a page, and telecommands of processes, oldest first.
    """

    metrics: dict[tuple[type, str], object] = field(default_factory=dict)
    series: list[Series[Any]] = field(default_factory=list)
    scheduler: str = ""
    last_error: str = ""
    orders: list[Order | ProcessOrder] = field(default_factory=list)

    def publish(self, record: object, stream: str = "") -> None:
        """Set a record to its present values. stream: the one that it is about, if any."""
        self.metrics[type(record), stream] = record

    def pack(self) -> bytes:
        """Return the message as octets, without its empty series."""
        series = [(one.kind, one.stream, one.values) for one in self.series if one.values]
        told = self.metrics, series, self.scheduler, self.last_error, self.orders
        return pickle.dumps(told, pickle.HIGHEST_PROTOCOL)

    @classmethod
    def unpack(cls, data: bytes) -> Message:
        """Unpack a message. Unpickling is safe: only our own process writes to the socket."""
        metrics, series, scheduler, last_error, orders = pickle.loads(data)
        told = [Series(*one) for one in series]
        return cls(metrics, told, scheduler, last_error, orders)


class Probe:
    """Collects the figures of a process in `message`, and its rows in `series`.

    When it is `due`, send `message`, and say with `handle_told` whether that worked.
    """

    def __init__(self) -> None:
        self.message = Message()
        self.publish = self.message.publish
        self._series: dict[tuple[object, str], Series[Any]] = {}
        self._due_ns = 0
        #: Values dropped because the launcher did not keep up.
        self.dropped_values = 0

    def series(self, kind: type[RowT], stream: str = "") -> Series[RowT]:
        """Return the series of rows of `kind`, of `stream` if the process has several.

        It is the same object during the start of the probe, so a fast loop may keep it.
        """
        found = self._series.get((kind, stream))
        if found is None:
            found = self._series[kind, stream] = Series(kind, stream)
            self.message.series.append(found)
        return found

    def due(self, now_ns: int) -> bool:
        """Return whether to fill in the counters and send `message` now."""
        return now_ns >= self._due_ns

    def handle_told(self, now_ns: int, *, told: bool) -> None:
        """Begin the next message if the present one was taken; else keep it for the next time."""
        self._due_ns = now_ns + FLUSH_NS
        if told:
            self.message.orders.clear()
            for series in self.message.series:
                del series.values[:]
            return
        for series in self.message.series:
            if len(series.values) > _MAX_SERIES_VALUES:
                # All of them, because a cut row would shift all that follow.
                self.dropped_values += len(series.values)
                self.publish(ProbeMetrics(probe_values_dropped=self.dropped_values))
                del series.values[:]
