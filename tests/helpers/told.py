"""Figures as a process reports them, for tests of their receivers."""

from pipelines.session.probe import Message, Series
from telepresence.link.figures import GatewayFigures, SenderFigures


def series(rows, stream=""):
    """A series of rows of one type."""
    told = Series(type(rows[0]), stream)
    told.extend(rows)
    return told


def message(*figures, rows=(), stream="", **others):
    """A message with records of `stream`, and with rows of one type or of several."""
    kinds = dict.fromkeys(map(type, rows))
    told = [series([row for row in rows if type(row) is kind], stream) for kind in kinds]
    made = Message(series=told, **others)
    for one in figures:
        made.tell(one, stream)
    return made


def gateway(*, transmit=None, receive=None, radio=None, supervision=None):
    """The link of one life of a gateway, of which only these parts are known."""
    transmit = SenderFigures() if transmit is None else transmit
    return GatewayFigures(transmit=transmit, receive=receive, radio=radio, supervision=supervision)
