"""Hands figures and events of a session from its launcher to those who show or keep them."""

from collections.abc import Iterator
from typing import Literal

import msgspec

from kontur_av.clock import NS_PER_MS, NS_PER_S, NS_PER_US
from pipelines.recording.recorder_metrics import FoxgloveMetrics, RecorderMetrics
from pipelines.report.collector import Collector
from pipelines.report.model import EndTrace, SessionReport, to_json
from pipelines.report.seat_metrics import SeatMetrics
from pipelines.report.session_report import build_report
from pipelines.seats.page_metrics import PageMetrics
from pipelines.session.launcher import Child, Launcher, launcher_cpu_s
from pipelines.session.session_metrics import (
    Event,
    LoopMetrics,
    MonitoredSession,
    ProcessState,
    SessionEvents,
)
from pipelines.session.setup.setup_text import setup_toml
from pipelines.session.topology.topics import CONSOLE, FOXGLOVE, METRICS, RECORDER, ROS2, SELECTOR
from pipelines.session.verdict import ProcessNow

#: Ends that meet again may take so long.
TIMEOUT_NS = 10 * NS_PER_S


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


#: How often these two are sent figures; a message for pages is made twice as often.
_RECORDED_EVERY_NS = 9 * NS_PER_S // 10
_MONITORED_EVERY_NS = 2 * NS_PER_S
#: A message is made at every second call.
_SUPERVISED_EVERY_NS = 9 * NS_PER_S // 10
_STOPPED = "stopped by a telecommand"


def processes_now(launcher: Launcher, **most: int) -> list[ProcessNow]:
    """The processes of `launcher`; once it has ended, as they were at the end.

    most: `most_restarts` that a process may need.
    """
    return [
        ProcessNow(
            name=child.row.name,
            restarts=child.restarts,
            running=child.ran if launcher.ended_ns else child.pid is not None,
            error=child.last_error if child.policy.wanted else _STOPPED,
            trouble=child.health.trouble(
                launcher.observed.now_ns,
                restarts=child.restarts,
                error=child.last_error,
                wanted=not child.stopped,
                ended=launcher.ended_ns > 0,
                **most,
            ),
        )
        for child in launcher.children
    ]


def session_report(launcher: Launcher, collector: Collector) -> SessionReport:
    """The report of what `launcher` runs or has run, until now."""
    return build_report(
        collector,
        seconds=launcher.seconds,
        cpu_s=launcher.cpu_s(),
        restarts={child.row.name: child.restarts for child in launcher.children},
        launcher_cpu_s=launcher_cpu_s(),
        stopped_s=launcher.stopped_s,
        processes=processes_now(launcher),
    )


class SeatFeed:
    """Makes a message for each page process while somebody watches its pages.

    Each start of a page process is sent every event once. So are the recorder while it records, and
    the bridge to Foxglove while it has clients, with the figures once a second. Monitoring and ROS
    2 systems get the report so far every two seconds.
    """

    def __init__(self, collector: Collector) -> None:
        self._metrics = SeatMetrics(collector)
        #: What happened, and what a systems operator must know now.
        self.log = self._metrics.log
        self._collector = collector
        #: By page process: its life, and the newest event that it was sent.
        self._told: dict[str, tuple[int | None, int]] = {}
        self._newest: dict[str, tuple[int | None, int]] = {}
        #: When recorder and bridge were sent figures last.
        self._recorded_ns = 0
        #: When a monitoring system was told last.
        self._monitored_ns = 0
        #: When the supervisors of processes were told last.
        self._supervised_ns = 0

    def poll_messages(self, launcher: Launcher, now_ns: int) -> dict[str, bytes]:
        """Return the messages of now; none while nobody watches."""
        self._metrics.handle_look(
            processes_now(launcher),
            switch=launcher.switch,
            started_ns=launcher.started_ns,
            now_ns=now_ns,
        )
        lives = {
            child.row.name: child.pid
            for child in launcher.children
            if child.row.name in launcher.pages
            and self._collector.process(child.row.name).total(PageMetrics).watching
        }
        followers = self._followers(launcher)
        metrics_due = bool(followers) and now_ns >= self._recorded_ns + _RECORDED_EVERY_NS
        messages = self._monitored(launcher, now_ns) | self._supervised(launcher, now_ns)
        for name, pid in followers.items() if not metrics_due else ():
            if events := self._events(name, pid):
                news = SessionEvents(at_us=now_ns // NS_PER_US, events=events)
                messages[name] = msgspec.json.encode(news)
        if not lives and not metrics_due:
            return messages
        message = self._metrics.message(
            launcher.cpu_s(),
            launcher_cpu_s=launcher_cpu_s(),
            running_ns=launcher.switch.running_ns(launcher.started_ns, now_ns),
            now_ns=now_ns,
        )
        for name, pid in followers.items() if metrics_due else ():
            self._recorded_ns = now_ns
            news = SessionEvents(
                at_us=message.at_us,
                events=self._events(name, pid),
                metrics=dict(message.figures),
            )
            messages[name] = msgspec.json.encode(news)
        for name, pid in lives.items():
            events = self._events(name, pid)
            messages[name] = msgspec.json.encode(msgspec.structs.replace(message, events=events))
        return messages

    def _monitored(self, launcher: Launcher, now_ns: int) -> dict[str, bytes]:
        due_ns = self._monitored_ns + _MONITORED_EVERY_NS
        monitors = {child.row.name for child in launcher.children} & {METRICS, ROS2}
        if not monitors or now_ns < due_ns:
            return {}
        self._monitored_ns = now_ns
        report = session_report(launcher, self._collector)
        start_s = self._collector.setup.radio_profile.start_s
        told = MonitoredSession(
            report=msgspec.Raw(to_json(report)),
            problems=[*report.failures, *without_contact(report, start_s, now_ns)],
        )
        return dict.fromkeys(monitors, msgspec.json.encode(told))

    def _supervised(self, launcher: Launcher, now_ns: int) -> dict[str, bytes]:
        """What the supervisors of both ends get of the processes of this machine."""
        supervisors = {child.row.name for child in launcher.children} & {SELECTOR, CONSOLE}
        if not supervisors or now_ns < self._supervised_ns + _SUPERVISED_EVERY_NS:
            return {}
        self._supervised_ns = now_ns
        told = [self._state(child, launcher, now_ns) for child in launcher.children]
        return dict.fromkeys(supervisors, msgspec.json.encode(told))

    def _state(self, child: Child, launcher: Launcher, now_ns: int) -> ProcessState:
        metrics, running = self._collector.process(child.row.name), child.pid is not None
        idle: Literal["down", "stopped"] = "down" if child.policy.wanted else "stopped"
        told_ns = metrics.told_ns or launcher.started_ns
        return ProcessState(
            name=child.row.name,
            state="running" if running else idle,
            restarts=child.restarts,
            cpu_s=child.cpu_s(),
            age_ms=(now_ns - told_ns) / NS_PER_MS if running else 0.0,
            loop=metrics.total(LoopMetrics),
        )

    def _events(self, process: str, pid: int | None) -> list[Event]:
        boot_id, number = self._told.get(process, (pid, 0))
        events = self.log.after(number if boot_id == pid else 0)
        self._newest[process] = pid, events[-1].number if events else number
        return events

    def _followers(self, launcher: Launcher) -> dict[str, int | None]:
        """The starts of the recorder, while it records, and of the bridge with clients."""
        process = self._collector.process
        following = {
            RECORDER: process(RECORDER).total(RecorderMetrics).recording,
            FOXGLOVE: process(FOXGLOVE).total(FoxgloveMetrics).watching > 0,
        }
        return {
            child.row.name: child.pid
            for child in launcher.children
            if following.get(child.row.name)
        }

    def handle_sent(self, process: str) -> None:
        if process in self._newest:
            self._told[process] = self._newest[process]


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
