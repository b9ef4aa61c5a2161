"""Figures as a process reports them, for tests of their receivers."""

from pipelines.session.figures import Counters
from pipelines.session.probe import Message, Series


def series(rows, stream=""):
    """A series of rows of one type."""
    told = Series(type(rows[0]), stream)
    told.extend(rows)
    return told


def message(*figures, rows=(), stream="", **others):
    """A message with counters and gauges of `stream`, and with rows of one type or of several."""
    kinds = dict.fromkeys(map(type, rows))
    told = [series([row for row in rows if type(row) is kind], stream) for kind in kinds]
    made = Message(series=told, **others)
    for one in figures:
        add = made.count if isinstance(one, Counters) else made.gauge
        add(one, stream)
    return made
