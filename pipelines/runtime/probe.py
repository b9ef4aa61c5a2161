"""What a process tells the launcher about itself, and how.

Figures leave a process a few times a second in one datagram over a socket that it inherited, so
that nothing but the last fraction of a second is lost with a process that is killed.
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
    """One report of one process.

    totals: counters since the process began. gauges: the newest value of whatever it is.
    series: rows of equal width, flattened: what a meter wants to see one by one.
    """

    totals: dict[str, int] = field(default_factory=dict)
    gauges: dict[str, Any] = field(default_factory=dict)
    series: dict[str, array[int]] = field(default_factory=dict)

    def pack(self) -> bytes:
        series = {name: rows for name, rows in self.series.items() if rows}
        return pickle.dumps((self.totals, self.gauges, series), pickle.HIGHEST_PROTOCOL)

    @classmethod
    def unpack(cls, data: bytes) -> Message:
        """Of a process of ours only: the socket pair is nobody else's."""
        return cls(*pickle.loads(data))


class Probe:
    """A process' end. Collect with `total`, `gauge` and `row`; `flush` when it is time."""

    def __init__(self, link: socket.socket | None) -> None:
        self._link = link
        self._message = Message()
        self._due_ns = 0
        #: Values of rows that were thrown away because the launcher did not keep up.
        self.dropped_values = 0

    def total(self, name: str, value: int) -> None:
        """A counter's present value."""
        self._message.totals[name] = value

    def gauge(self, name: str, value: Any) -> None:
        """The newest value of something; plain types only."""
        self._message.gauges[name] = value

    def row(self, series: str, *values: int) -> None:
        """One row of `series`; every row of one series has the same width."""
        self.rows(series).extend(values)

    def rows(self, series: str) -> array[int]:
        """Where the rows of `series` are collected, flattened.

        The same object as long as the probe lives: a fast loop appends to it by itself.
        """
        rows = self._message.series.get(series)
        if rows is None:
            rows = self._message.series[series] = array("q")
        return rows

    def due(self, now_ns: int) -> bool:
        """Whether it is time to fill in the totals and to `flush`."""
        return now_ns >= self._due_ns

    def flush(self, now_ns: int) -> None:
        """Send what was collected; on a full socket it is kept for the next time."""
        self._due_ns = now_ns + FLUSH_NS
        if self._link is None or self._send(self._link):
            self.clear()
            return
        for rows in self._message.series.values():
            if len(rows) > _MAX_SERIES_VALUES:
                # Whole, because a row that is cut would shift all that follow.
                self.dropped_values += len(rows)
                del rows[:]

    @property
    def message(self) -> Message:
        """What was collected, for whoever needs no socket to get it; then `clear`."""
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
