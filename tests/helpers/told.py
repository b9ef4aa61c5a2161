"""Figures as a process reports them, for tests of their receivers."""

from pipelines.session.probe import Message, Series
from pipelines.session.session_metrics import ProcessNow
from telepresence.link.link_metrics import GatewayMetrics, SenderMetrics


def series(rows, stream=""):
    """A series of rows of one type."""
    told = Series(type(rows[0]), stream)
    told.extend(rows)
    return told


def message(*metrics, rows=(), stream="", **others):
    """A message with records of `stream`, and with rows of one type or of several."""
    kinds = dict.fromkeys(map(type, rows))
    told = [series([row for row in rows if type(row) is kind], stream) for kind in kinds]
    made = Message(series=told, **others)
    for metric in metrics:
        made.publish(metric, stream)
    return made


def gateway(*, transmit=None, receive=None, radio=None, supervision=None):
    """The link of one start of a gateway, of which only these parts are known."""
    transmit = SenderMetrics() if transmit is None else transmit
    return GatewayMetrics(transmit=transmit, receive=receive, radio=radio, supervision=supervision)


def processes(names, cpu_s=0.0, **changes):
    """Processes as their launcher knows them. changes: what differs, by name."""
    return [ProcessNow(name=name, **{"cpu_s": cpu_s, **changes.get(name, {})}) for name in names]
