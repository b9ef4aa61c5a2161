"""The figures of the pages are those that the report would have, and each message has its parts."""

import json
from functools import partial
from types import SimpleNamespace

import msgspec
import pytest
from told import message

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.rtp.receiver import ReceiverCounts
from kontur_av.streams.staleness import State
from kontur_av.streams.video_receiver import VideoReceiverCounts
from pipelines.media.media_metrics import DisplayMetrics, SelectorMetrics
from pipelines.report.collector import Collector
from pipelines.report.model import to_builtins
from pipelines.report.seat_feed import SeatFeed
from pipelines.report.seat_metrics import SeatMessage, SeatMetrics
from pipelines.report.session_report import build_report
from pipelines.seats.page_metrics import PageMetrics
from pipelines.session.session_metrics import (
    LoopMetrics,
    OutRow,
    ProcessState,
    SampleReceivedRow,
    SampleSentRow,
)
from pipelines.session.session_switch import Order, RestartPolicy, SessionSwitch
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.session.verdict import ObservedTime, ProcessHealth, ProcessNow
from pipelines.table import topology_of
from telepresence.haptics.haptic_metrics import SamplesReceived, SamplesSent

SETUP = BUILT_IN["spacejustin"]
TOPOLOGY = topology_of(SETUP, pages=True)
SUPERVISORS = ("console", "selector")
CPU_S = {row.name: 0.5 for row in TOPOLOGY.processes}


@pytest.fixture
def collector():
    """A session of two seconds: a picture's packets, samples of the hand, what is shown."""
    collector = Collector(TOPOLOGY)
    out = [OutRow(k * 10 * NS_PER_MS, 100, 85_000) for k in range(200)]
    sent = [SampleSentRow(k, k * NS_PER_MS) for k in range(1000, 2000)]
    felt = [SampleReceivedRow(k, (k + 11) * NS_PER_MS) for k in range(1000, 2000)]
    now_ns = 2 * NS_PER_S
    for process, rows, counters in (
        ("uplink_video_send", out, ()),
        ("robot", sent, (SamplesSent(sent=1000),)),
        ("joystick", felt, (SamplesReceived(received=1000, lost=3),)),
        (
            "uplink_video_receive",
            (),
            (VideoReceiverCounts(rtp=ReceiverCounts(rtp_packets=197, rtp_lost=3)),),
        ),
        ("selector", (), (SelectorMetrics(selected="stereo"),)),
    ):
        collector.handle_message(process, message(*counters, rows=rows), now_ns)
    shown = DisplayMetrics(frames_displayed=58, age_ns=45 * NS_PER_MS, state=State.FRESH)
    collector.handle_message("space_display", message(shown, stream="uplink_video"), now_ns)
    return collector


def processes(**changes):
    capabilities = {"restarts": 0, "running": True, "error": ""}
    return [ProcessNow(name=name, **{**capabilities, **changes.get(name, {})}) for name in CPU_S]


@pytest.fixture
def metrics(collector):
    return SeatMetrics(collector)


def look(metrics, at_s=2.0, switch=None, **changes):
    now_ns, switch = round(at_s * NS_PER_S), switch or SessionSwitch()
    metrics.handle_look(processes(**changes), switch=switch, started_ns=0, now_ns=now_ns)


def told(metrics, at_s=2.0, cpu_s=CPU_S):
    now_ns = round(at_s * NS_PER_S)
    return metrics.message(cpu_s, launcher_cpu_s=1.0, running_ns=now_ns, now_ns=now_ns)


def at(report, key):
    """What the report has under a key like `uplink_video.latency_ms.p99.9`; None for nothing."""
    section = report["streams"] if key.partition(".")[0] in report["streams"] else report
    while key:
        if not isinstance(section, dict):
            return None
        # A key of the report may have a dot in it: p99.9.
        name = key if key in section else key.partition(".")[0]
        section, key = section.get(name), key[len(name) + 1 :]
    return section


def test_every_figure_is_that_of_the_report_and_what_is_true_now_is_beside_it(collector, metrics):
    look(metrics)
    found = told(metrics).figures
    restarts = dict.fromkeys(CPU_S, 0)
    report = to_builtins(
        build_report(collector, seconds=2.0, cpu_s=CPU_S, restarts=restarts, launcher_cpu_s=1.0)
    )
    own = {"age_ms", "state", "rate_bps", "least", "most"}
    # The report has what TM/TC counted among the counts of its processes.
    shared = {
        key: value
        for key, value in found.items()
        if key.rpartition(".")[2] not in own and not key.startswith("tmtc.")
    }
    assert len(shared) > 100
    for key, value in shared.items():
        # Percentiles of nothing have no value on a page.
        assert value is None or value == at(report, key), key
    assert (found["tmtc.space.k2aci_arrived"], found["uplink_video.rtp_lost"]) == (0, 3)
    assert found["haptic.up.latency_ms.p50"] == pytest.approx(11, rel=0.01)
    assert found["processes.selector.selected"] == "stereo"
    assert found["uplink_voice.latency_ms.p50"] is None
    assert found["uplink_voice.latency_ms.count"] == 0
    look(metrics)
    now, later = told(metrics).figures, told(metrics, 5.0).figures
    names = ("age_ms", "state", "rate_bps")
    assert [now[f"uplink_video.{name}"] for name in names] == [45.0, "fresh", 80_000]
    assert [later[f"uplink_video.{name}"] for name in names] == [2045.0, "stale", 0]
    assert (now["uplink_voice.age_ms"], now["uplink_voice.state"]) == (None, "nothing")
    assert now["haptic.up.rate_bps"] == 96_000


def test_the_share_of_a_core_is_that_of_the_last_two_seconds(metrics):
    def robot(at_s, spent_s):
        look(metrics, at_s)
        found = told(metrics, at_s, {**CPU_S, "robot": spent_s}).processes
        return next(each.cpu for each in found if each.name == "robot")

    assert robot(10, 5.0) is None
    assert robot(10.5, 5.1) == 0.2
    assert [robot(11 + k / 2, 5.1) for k in range(4)] == [0.1, 0.067, 0.05, 0.0]
    # Nobody watched in between.
    assert robot(30, 20.0) is None


def test_a_message_has_the_fields_that_pages_rely_on(collector, metrics):
    robot = {"restarts": 2, "running": False, "error": "ended by SIGKILL", "trouble": ""}
    # Ground control is told which page holds the handle.
    holding = message(PageMetrics(watching=1, holder=3))
    for holder in (None, 3):
        look(metrics, robot=robot)
        assert told(metrics).figures["hand.holder"] == holder
        collector.handle_message("page_space", holding, 2 * NS_PER_S)
    found = json.loads(msgspec.json.encode(told(metrics)))
    assert list(found) == [
        *("kind", "at_us", "seconds", "state", "figures", "link", "processes", "events")
    ]
    assert (found["kind"], found["at_us"], found["seconds"]) == ("figures", 2_000_000, 2.0)
    assert found["state"] == "running"
    assert set(found["link"]) == {"uplink", "downlink"}
    assert set(found["link"]["uplink"]) == {"octets", "drops", "lost", "slips"}
    by_name = {each["name"]: each for each in found["processes"]}
    assert by_name["robot"] == {"name": "robot", "segment": "ground", "cpu": None, **robot}
    assert list(by_name) == list(CPU_S)
    assert all(not isinstance(value, list | dict) for value in found["figures"].values())
    switch = SessionSwitch()
    for change in (partial(switch.handle_order, Order.STOP), switch.handle_all_ended):
        change(3)
        look(metrics, switch=switch)
        assert told(metrics).state == "stopped"


class Launcher:
    """What the feed asks of a launcher, without the supervisors, who are always told."""

    def __init__(self, *, supervisors=False):
        self.switch, self.started_ns, self.pages = SessionSwitch(), 0, {"page_space": None}
        self.ended_ns, self.observed = 0, ObservedTime()
        self.cpu_asked = 0
        rows = [row for row in TOPOLOGY.processes if supervisors or row.name not in SUPERVISORS]
        capabilities = {"restarts": 0, "last_error": "", "cpu_s": lambda: 0.5, "stopped": False}
        self.children = [
            SimpleNamespace(
                row=row,
                pid=number,
                policy=RestartPolicy(row.stage),
                health=ProcessHealth(),
                **capabilities,
            )
            for number, row in enumerate(rows, 1)
        ]

    def cpu_s(self):
        self.cpu_asked += 1
        return CPU_S

    def restart(self, name):
        (child,) = [child for child in self.children if child.row.name == name]
        child.pid += 1000


def watched(collector, page, watching, at_s=2.0):
    told = message(PageMetrics(watching=watching))
    collector.handle_message(page, told, round(at_s * NS_PER_S))


def events(feed, launcher, at_s):
    """The numbers of the events in the message to the page in space."""
    messages = feed.poll_messages(launcher, round(at_s * NS_PER_S))
    found = msgspec.json.decode(messages["page_space"], type=SeatMessage)
    return [event.number for event in found.events]


def test_without_a_watcher_there_is_no_message_and_no_cost(collector):
    feed, launcher = SeatFeed(collector), Launcher()
    watched(collector, "page_space", 0)
    # The other page has no listener here.
    watched(collector, "page_ground", 3)
    assert feed.poll_messages(launcher, 3 * NS_PER_S) == {}
    assert launcher.cpu_asked == 0
    watched(collector, "page_space", 1)
    assert set(feed.poll_messages(launcher, 3 * NS_PER_S)) == {"page_space"}


def test_the_supervisors_of_both_ends_are_told_of_every_process_once_a_second(collector):
    feed, launcher = SeatFeed(collector), Launcher(supervisors=True)
    loop = LoopMetrics(cycles=7, slips=1)
    collector.handle_message("robot", message(loop), NS_PER_S)
    children = {child.row.name: child for child in launcher.children}
    children["robot"].policy.handle_wanted(False, 0)
    children["stereo"].pid = None

    def states(seconds, supervisor):
        messages = feed.poll_messages(launcher, round(seconds * NS_PER_S))
        assert set(messages) in (set(SUPERVISORS), set())
        found = msgspec.json.decode(messages.get(supervisor, b"[]"), type=list[ProcessState])
        return {one.name: one for one in found}

    found = states(2, "console")
    assert found["robot"] == ProcessState(
        name="robot", state="running", cpu_s=0.5, age_ms=1000.0, loop=loop
    )
    assert (found["stereo"].state, found["stereo"].age_ms) == ("down", 0.0)
    children["robot"].pid = None
    assert states(2.5, "console") == {}
    assert states(3, "selector")["robot"].state == "stopped"


def test_each_life_of_a_page_process_gets_every_event_once(collector):
    feed, launcher = SeatFeed(collector), Launcher()
    # Something happens before anybody watches.
    launcher.switch.handle_order(Order.STOP, 0)
    feed.poll_messages(launcher, 2 * NS_PER_S)
    watched(collector, "page_space", 1)
    assert events(feed, launcher, 3) == [1]
    # The message was lost, because the process did not read.
    assert events(feed, launcher, 3.5) == [1]
    feed.handle_sent("page_space")
    assert events(feed, launcher, 4) == []
    feed.handle_sent("page_space")
    launcher.switch.handle_all_ended(5)
    launcher.switch.handle_order(Order.START, 6)
    collector.handle_resumed(6)
    assert events(feed, launcher, 5) == [2]
    feed.handle_sent("page_space")
    launcher.restart("page_space")
    assert events(feed, launcher, 6) == [1, 2]
