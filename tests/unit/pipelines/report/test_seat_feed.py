"""Contact that is due and missing, as health checks and monitors are told."""

from types import SimpleNamespace

from kontur_av.clock import NS_PER_S
from pipelines.report.seat_feed import without_contact


def told(state="connected", since_s=0, windows=None):
    """A report of a session that began at 100 s."""
    supervision = SimpleNamespace(
        state=state, begun_ns=100 * NS_PER_S, since_ns=since_s * NS_PER_S, why="no signal"
    )
    contact = None
    if windows is not None:
        contact = SimpleNamespace(acquisition_s=windows[0], loss_s=windows[1])
    gateway = SimpleNamespace(supervision=supervision, contact=contact)
    return SimpleNamespace(gateways={"ground": gateway})


def at(report, seconds):
    return list(without_contact(report, 0.0, (100 + seconds) * NS_PER_S))


def test_contact_is_missed_only_where_it_is_due():
    assert at(told(), 45) == at(told("search", since_s=30), 38) == []
    (line,) = at(told("search", since_s=30), 45)
    assert line == "ground: no contact for 15 s, though it is due: no signal"
    assert at(told("search", since_s=30, windows=(60, 90)), 45) == []
    # Since the acquisition, not since the loss before it.
    assert at(told("search", since_s=30, windows=(60, 90)), 65) == []
    assert "no contact for 15 s" in at(told("search", since_s=30, windows=(60, 90)), 75)[0]
    assert at(told("search", since_s=30, windows=(60, 90)), 95) == []
