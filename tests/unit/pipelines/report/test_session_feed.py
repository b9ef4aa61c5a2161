"""Each follower of a session is told what it asks for, once a second, and every event once."""

from types import SimpleNamespace

import msgspec
from told import message

from kontur_av.clock import NS_PER_S
from pipelines.recording.recorder_metrics import RecorderMetrics
from pipelines.report.collector import Collector
from pipelines.report.session_feed import SessionFeed, without_contact
from pipelines.seats.page_metrics import PageMetrics
from pipelines.session.session_metrics import LoopMetrics, ProcessNow, SessionNews
from pipelines.session.session_switch import Order, RestartPolicy, SessionSwitch
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.session.topology.topics import METRICS, RECORDER
from pipelines.session.verdict import ObservedTime, ProcessHealth
from pipelines.table import topology_of

TOPOLOGY = topology_of(BUILT_IN["spacejustin"], pages=True, metrics=True)
SUPERVISORS = {"console", "selector"}


class Launcher:
    """What the feed asks of a launcher, with the supervisors and the process of `--metrics`."""

    def __init__(self):
        self.switch, self.started_ns, self.pages = SessionSwitch(), 0, {"page_space": None}
        self.ended_ns, self.observed, self.stopped_s = 0, ObservedTime(), []
        self.clock = SimpleNamespace(now_ns=lambda: self.now_ns)
        self.now_ns = self.spent_s = 0
        self.children = [
            SimpleNamespace(
                row=row,
                pid=number,
                policy=RestartPolicy(row.stage),
                health=ProcessHealth(),
                restarts=0,
                last_error="",
                cpu_s=lambda: self.spent_s,
                stopped=False,
            )
            for number, row in enumerate(TOPOLOGY.processes, 1)
        ]

    @property
    def seconds(self):
        return self.now_ns / NS_PER_S

    def child(self, name):
        (child,) = [child for child in self.children if child.row.name == name]
        return child


class Session:
    """A feed of a launcher whose processes tell what a test says."""

    def __init__(self):
        self.collector, self.launcher = Collector(TOPOLOGY), Launcher()
        self.feed = SessionFeed(self.collector)

    def tell(self, process, record):
        self.collector.handle_message(process, message(record), self.launcher.now_ns)

    def look(self, at_s, *, lost=()):
        """The messages of an instant, by process. lost: those that do not read theirs."""
        self.launcher.now_ns = round(at_s * NS_PER_S)
        messages = self.feed.poll_messages(self.launcher, self.launcher.now_ns)
        names = {child.pid: child.row.name for child in self.launcher.children}
        for pid in messages:
            if names[pid] not in lost:
                self.feed.handle_sent(pid)
        return {
            names[pid]: msgspec.json.decode(text, type=SessionNews)
            for pid, text in messages.items()
        }


def test_a_follower_gets_figures_while_it_needs_them_and_a_monitor_the_report():
    session = Session()
    session.launcher.child(METRICS).pid = None
    found = session.look(1)
    # Nobody needs a figure, so none is made.
    assert set(found) == SUPERVISORS and not found["console"].figures
    session.tell("page_space", PageMetrics(watching=1))
    # The other page has no listener here.
    session.tell("page_ground", PageMetrics(watching=3))
    session.launcher.child(METRICS).pid = 1000
    found = session.look(2)
    assert set(found) == {*SUPERVISORS, METRICS, "page_space"}
    assert found["page_space"].figures["hand.holder"] is None
    assert msgspec.json.decode(found["page_space"].report) is None
    report = msgspec.json.decode(found[METRICS].report)
    assert report["streams"]["uplink_video"]["rate_bps"] == 0
    assert (found["page_space"].seconds, found["page_space"].state) == (2.0, "running")
    session.tell(RECORDER, RecorderMetrics(recording=True))
    recorders = [name for name in session.look(3) if name == RECORDER]
    assert recorders == [
        child.row.name for child in session.launcher.children if child.row.name == RECORDER
    ]
    session.tell("page_space", PageMetrics(watching=0))
    assert "page_space" not in session.look(4)


def test_the_supervisors_of_both_ends_are_told_of_every_process():
    session = Session()
    session.launcher.now_ns = NS_PER_S
    session.tell("robot", LoopMetrics(cycles=7, slips=1))
    child = session.launcher.child
    child("robot").policy.handle_wanted(False, 0)
    child("stereo").pid = None

    def states(at_s, spent_s):
        session.launcher.spent_s = spent_s
        return {each.name: each for each in session.look(at_s)["console"].processes}

    found = states(2, 0.5)
    assert found["robot"] == ProcessNow(
        name="robot",
        segment="ground",
        error="stopped by a telecommand",
        cpu_s=0.5,
        age_ms=1000.0,
        slips=1,
        cycles=7,
    )
    assert (found["stereo"].state, found["stereo"].age_ms) == ("down", 0.0)
    child("robot").pid = None
    # The share of a core is that of the last two seconds.
    assert (found := states(3, 0.75)["robot"]).state == "stopped"
    assert [found.cpu, *(states(at_s, 0.75)["robot"].cpu for at_s in (4, 5))] == [0.25, 0.125, 0.0]


def test_each_life_of_a_follower_gets_every_event_once():
    session = Session()

    def events(at_s, **others):
        return [each.number for each in session.look(at_s, **others)["page_space"].events]

    # Something happens before anybody watches.
    session.launcher.switch.handle_order(Order.STOP, 0)
    session.look(2)
    session.tell("page_space", PageMetrics(watching=1))
    # It is told again, because the process did not read.
    assert events(3, lost=["page_space"]) == events(4) == [1]
    assert events(5) == []
    session.launcher.switch.handle_all_ended(5)
    session.launcher.switch.handle_order(Order.START, 6)
    session.collector.handle_resumed(6)
    assert events(6) == [2]
    session.launcher.child("page_space").pid += 1000
    assert events(7) == [1, 2]


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
