"""Problems of a session, as health checks and monitors are told them."""

from types import SimpleNamespace

from kontur_av.clock import NS_PER_S
from pipelines.report.seat_feed import SessionHealth


def told(state="connected", since_s=0, windows=None, failures=()):
    """A report of a session that began at 100 s."""
    supervision = SimpleNamespace(
        state=state, begun_ns=100 * NS_PER_S, since_ns=since_s * NS_PER_S, why="no signal"
    )
    contact = None
    if windows is not None:
        contact = SimpleNamespace(acquisition_s=windows[0], loss_s=windows[1])
    gateway = SimpleNamespace(supervision=supervision, contact=contact)
    return SimpleNamespace(failures=list(failures), gateways={"ground": gateway})


def at(report, seconds, *, down=(), health=None):
    health = health or SessionHealth(0.0)
    return health.problems(report, down, (100 + seconds) * NS_PER_S)


def test_failures_are_problems_and_contact_is_missed_only_where_it_is_due():
    assert at(told(failures=["above its cap"]), 1) == ["above its cap"]
    health = SessionHealth(0.0)
    assert at(told(), 20, down=["robot"], health=health) == []
    assert at(told(), 28, down=["robot"], health=health) == []
    assert at(told(), 30, health=health) == []
    assert at(told(), 32, down=["robot"], health=health) == []
    assert at(told(), 44, down=["robot"], health=health) == ["robot does not come back"]
    assert at(told("search", since_s=30), 38) == []
    (line,) = at(told("search", since_s=30), 45)
    assert line == "ground: no contact for 15 s, though it is due: no signal"
    assert at(told("search", since_s=30, windows=(60, 90)), 45) == []
    # Since the acquisition, not since the loss before it.
    assert at(told("search", since_s=30, windows=(60, 90)), 65) == []
    assert "no contact for 15 s" in at(told("search", since_s=30, windows=(60, 90)), 75)[0]
    assert at(told("search", since_s=30, windows=(60, 90)), 95) == []
