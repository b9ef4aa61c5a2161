"""The figures of a process, and their way to the launcher.

A process sends its figures twice a second, in one datagram over an inherited socket. So a process
that is killed loses only the figures of its last half second.
"""

from __future__ import annotations

import pickle
import socket
from array import array
from dataclasses import dataclass, field
from typing import Any

from kontur_av.clock import NS_PER_MS

FLUSH_NS = 500 * NS_PER_MS
_MAX_SERIES_VALUES = 20_000


@dataclass(slots=True)
class Message:
    """One message of one process.

    totals: counters since the process began. gauges: newest values of other figures.
    series: rows of equal width, flattened: single events, such as packets.
    """

    totals: dict[str, int] = field(default_factory=dict)
    gauges: dict[str, Any] = field(default_factory=dict)
    series: dict[str, array[int]] = field(default_factory=dict)

    def pack(self) -> bytes:
        series = {name: rows for name, rows in self.series.items() if rows}
        return pickle.dumps((self.totals, self.gauges, series), pickle.HIGHEST_PROTOCOL)

    @classmethod
    def unpack(cls, data: bytes) -> Message:
        """Unpack a message. Unpickling is safe: only our own process writes to the socket."""
        return cls(*pickle.loads(data))


class Probe:
    """The process's end. Collect with `total`, `gauge` and `row`; `flush` when it is due."""

    def __init__(self, link: socket.socket | None) -> None:
        self._link = link
        self._message = Message()
        self._due_ns = 0
        #: Values of rows that were dropped because the launcher did not keep up.
        self.dropped_values = 0

    def total(self, name: str, value: int) -> None:
        """Set a counter to its present value."""
        self._message.totals[name] = value

    def gauge(self, name: str, value: Any) -> None:
        """Set a figure to its newest value, of a plain type."""
        self._message.gauges[name] = value

    def row(self, series: str, *values: int) -> None:
        """Add a row to `series`; all rows of a series have the same width."""
        self.rows(series).extend(values)

    def rows(self, series: str) -> array[int]:
        """Return the array in which the rows of `series` are collected, flattened.

        It is the same object during the life of the probe, so a fast loop may append to it.
        """
        rows = self._message.series.get(series)
        if rows is None:
            rows = self._message.series[series] = array("q")
        return rows

    def due(self, now_ns: int) -> bool:
        """Return whether to fill in the totals and `flush` now."""
        return now_ns >= self._due_ns

    def flush(self, now_ns: int) -> None:
        """Send the present message. If the socket is full, keep it for the next time."""
        self._due_ns = now_ns + FLUSH_NS
        if self._link is None or self._send(self._link):
            self.clear()
            return
        for rows in self._message.series.values():
            if len(rows) > _MAX_SERIES_VALUES:
                # All of them, because a cut row would shift all that follow.
                self.dropped_values += len(rows)
                del rows[:]

    @property
    def message(self) -> Message:
        """The present message, for a reader in the same process; `clear` it afterwards."""
        return self._message

    def clear(self) -> None:
        """Begin the next message."""
        for rows in self._message.series.values():
            del rows[:]
        self._message.gauges.clear()

    def _send(self, link: socket.socket) -> bool:
        if self.dropped_values:
            self._message.totals["probe_values_dropped"] = self.dropped_values
        try:
            link.send(self._message.pack(), socket.MSG_DONTWAIT)
        except OSError:
            return False
        return True
