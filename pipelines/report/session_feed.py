"""What a running session tells once a second: its report, and news to those who follow it."""

from collections import deque
from collections.abc import Iterator, Mapping

import msgspec
from msgspec.structs import replace

from kontur_av.clock import NS_PER_MS, NS_PER_S, NS_PER_US
from pipelines.recording.recorder_metrics import FoxgloveMetrics, RecorderMetrics
from pipelines.report.collector import Collector
from pipelines.report.event_log import EventLog
from pipelines.report.figures import figures_of
from pipelines.report.model import EndTrace, SessionReport, to_builtins
from pipelines.report.session_report import build_report
from pipelines.seats.page_metrics import PageMetrics
from pipelines.session.launcher import Child, Launcher, launcher_cpu_s
from pipelines.session.session_metrics import LoopMetrics, ProcessNow, SessionNews
from pipelines.session.session_switch import Activity
from pipelines.session.setup.setup_text import setup_toml
from pipelines.session.topology.topics import CONSOLE, FOXGLOVE, METRICS, RECORDER, ROS2, SELECTOR

#: Ends that meet again may take so long.
TIMEOUT_NS = 10 * NS_PER_S
#: They get the report, and those the processes alone. All other followers get the figures.
_MONITORS, _SUPERVISORS = {METRICS, ROS2}, {SELECTOR, CONSOLE}
_NO_REPORT = SessionNews().report
_STOPPED = "stopped by a telecommand"


def without_contact(report: SessionReport, start_s: float, now_ns: int) -> Iterator[str]:
    """Yield a line for each end without the contact that is due.

    start_s: where in the radio's pass the session begins.
    """
    for end, gateway in report.gateways.items():
        told = gateway.supervision
        if told is None or told.state == "connected":
            continue
        silent_ns = now_ns - told.begun_ns - told.since_ns
        windows = gateway.contact
        if windows is not None:
            pass_s = start_s + (now_ns - told.begun_ns) / NS_PER_S
            if not windows.acquisition_s <= pass_s < windows.loss_s:
                continue
            due_ns = round((pass_s - windows.acquisition_s) * NS_PER_S)
            silent_ns = min(silent_ns, due_ns)
        if silent_ns > TIMEOUT_NS:
            seconds = silent_ns // NS_PER_S
            yield f"{end}: no contact for {seconds} s, though it is due: {told.why}"


def processes_now(launcher: Launcher, collector: Collector, **most: int) -> list[ProcessNow]:
    """The processes of `launcher`; once it has ended, as they were at the end.

    most: `most_restarts` that a process may need.
    """
    return [_process_now(child, launcher, collector, **most) for child in launcher.children]


def _process_now(child: Child, launcher: Launcher, collector: Collector, **most: int) -> ProcessNow:
    name, now_ns, ended = child.row.name, launcher.clock.now_ns(), launcher.ended_ns > 0
    runs = child.ran if ended else child.pid is not None
    metrics = collector.process(name)
    loop = metrics.total(LoopMetrics)
    told_ns = metrics.told_ns or launcher.started_ns
    return ProcessNow(
        name=name,
        segment=None if child.row.segment is None else child.row.segment.value,
        state="running" if runs else "down" if child.policy.wanted else "stopped",
        restarts=child.restarts,
        error=child.last_error if child.policy.wanted else _STOPPED,
        trouble=child.health.trouble(
            launcher.observed.now_ns,
            restarts=child.restarts,
            error=child.last_error,
            wanted=not child.stopped,
            ended=ended,
            **most,
        ),
        cpu_s=child.cpu_s(),
        age_ms=(now_ns - told_ns) / NS_PER_MS if runs else 0.0,
        slips=loop.slips,
        cycles=loop.cycles,
    )


def session_report(
    launcher: Launcher,
    collector: Collector,
    processes: list[ProcessNow] | None = None,
    now_ns: int | None = None,
) -> SessionReport:
    """The report of what `launcher` runs or has run, until now; now_ns: while it runs."""
    return build_report(
        collector,
        seconds=launcher.seconds,
        processes=processes_now(launcher, collector) if processes is None else processes,
        launcher_cpu_s=launcher_cpu_s(),
        stopped_s=launcher.stopped_s,
        now_ns=now_ns,
    )


class SessionFeed:
    """Makes one report a second, and from it the messages to the processes that follow the session.

    These are the pages that somebody watches, the recorder while it records, the bridge to Foxglove
    while it has clients, monitoring and ROS 2 systems, and the supervisors of processes. Each start
    of them is sent every event once.
    """

    def __init__(self, collector: Collector) -> None:
        #: What happened, and what a systems operator must know now.
        self.log = EventLog(collector)
        self._collector = collector
        #: Of the look of this second.
        self._processes: list[ProcessNow] | None = None
        self._report: SessionReport | None = None
        #: Instants of the last looks, with the CPU seconds of each process.
        self._looks: deque[tuple[int, Mapping[str, float]]] = deque(maxlen=3)
        #: By pid: the number of the newest event that it was sent.
        self._told: dict[int, int] = {}

    def report(self, launcher: Launcher) -> SessionReport:
        """The report of this second."""
        if self._report is None:
            now_ns = launcher.clock.now_ns()
            processes = self._look(launcher, now_ns)
            self._report = session_report(launcher, self._collector, processes, now_ns)
        return self._report

    def poll_messages(self, launcher: Launcher, now_ns: int) -> dict[int, bytes]:
        """Return the messages of this second by the pid of their receiver; then the next begins."""
        self._look(launcher, now_ns)
        followers = {
            child.pid: child.row.name
            for child in launcher.children
            if child.pid is not None and self._follows(child.row.name, launcher)
        }
        news = self._news(launcher, {*followers.values()}, now_ns) if followers else SessionNews()
        messages = {}
        for pid, name in followers.items():
            report = news.report if name in _MONITORS else _NO_REPORT
            events = self.log.after(self._told.get(pid, 0))
            messages[pid] = msgspec.json.encode(replace(news, events=events, report=report))
        self._processes = self._report = None
        return messages

    def handle_sent(self, pid: int) -> None:
        self._told[pid] = self.log.number

    def _look(self, launcher: Launcher, now_ns: int) -> list[ProcessNow]:
        """Note what happened; return the processes, once a second."""
        if self._processes is not None:
            return self._processes
        processes = processes_now(launcher, self._collector)
        self._looks.append((now_ns, {each.name: each.cpu_s for each in processes}))
        before_ns, before_s = self._looks[0]
        if passed_s := (now_ns - before_ns) / NS_PER_S:
            shares = (each.cpu_s - before_s[each.name] for each in processes)
            processes = [
                replace(each, cpu=round(spent_s / passed_s, 3))
                for each, spent_s in zip(processes, shares, strict=True)
            ]
        self.log.handle_look(
            processes, switch=launcher.switch, started_ns=launcher.started_ns, now_ns=now_ns
        )
        self._processes = processes
        return processes

    def _follows(self, name: str, launcher: Launcher) -> bool:
        process = self._collector.process(name)
        if name == RECORDER:
            return process.total(RecorderMetrics).recording
        if name == FOXGLOVE:
            return process.total(FoxgloveMetrics).watching > 0
        if name in launcher.pages and name != METRICS:
            return process.total(PageMetrics).watching > 0
        return name in _MONITORS | _SUPERVISORS

    def _news(self, launcher: Launcher, followers: set[str], now_ns: int) -> SessionNews:
        """The message of now, with figures and report if anybody gets them."""
        news = SessionNews(
            at_us=now_ns // NS_PER_US,
            seconds=round((now_ns - launcher.started_ns) / NS_PER_S, 3),
            state="running" if launcher.switch.activity is Activity.RUNNING else "stopped",
            processes=self._look(launcher, now_ns),
        )
        if not followers - _SUPERVISORS:
            return news
        report = self.report(launcher)
        tables = to_builtins(report)
        start_s = self._collector.setup.radio_profile.start_s
        return replace(
            news,
            figures=figures_of(
                tables,
                self._collector,
                self.log.upkeep,
                pass_s=start_s + (now_ns - launcher.started_ns) / NS_PER_S,
                now_ns=now_ns,
            ),
            problems=[*report.failures, *without_contact(report, start_s, now_ns)],
            report=msgspec.Raw(msgspec.json.encode(tables)),
        )


def end_trace(collector: Collector, launcher: Launcher) -> EndTrace:
    """What a join with the other end's report needs of this one."""
    assert collector.trace is not None
    (segment,) = collector.topology.segments
    links = [link.supervision for link in collector.gateway(segment).links()]
    return EndTrace(
        setup=setup_toml(launcher.setup),
        wall_offset_ns=launcher.clock.wall_offset_ns,
        began_ns=launcher.started_ns,
        ended_ns=launcher.ended_ns,
        lives=[link.boot_id for link in links],
        peers=[link.peer.boot_id for link in links if link.peer.boot_id is not None],
        series=collector.trace.report(),
    )
