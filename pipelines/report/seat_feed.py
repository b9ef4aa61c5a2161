"""Hands figures and events of a session from its launcher to the pages and to the recorder."""

import msgspec

from pipelines.report.collector import Collector
from pipelines.report.event_log import ProcessNow
from pipelines.report.seat_figures import SeatFigures
from pipelines.session.figures import PageGauges, RecorderGauges
from pipelines.session.launcher import Launcher, launcher_cpu_s
from pipelines.session.session_events import Event, SessionEvents
from pipelines.session.setup.table import Setup
from pipelines.session.topology import RECORDER


class SeatFeed:
    """Makes a message for each page process while somebody watches its pages.

    Each life of a page process is sent every event once. So is the recorder while it records,
    without figures.
    """

    def __init__(self, setup: Setup, collector: Collector) -> None:
        self._figures = SeatFigures(setup, collector)
        self._collector = collector
        #: By page process: its life, and the newest event that it was sent.
        self._told: dict[str, tuple[int | None, int]] = {}
        self._newest: dict[str, tuple[int | None, int]] = {}

    def poll_messages(self, launcher: Launcher, now_ns: int) -> dict[str, bytes]:
        """Return the messages of now; none while nobody watches."""
        self._figures.handle_look(
            [
                ProcessNow(
                    name=child.row.name,
                    restarts=child.restarts,
                    running=child.pid is not None,
                    error=child.last_error,
                )
                for child in launcher.children
            ],
            switch=launcher.switch,
            started_ns=launcher.started_ns,
            now_ns=now_ns,
        )
        lives = {
            child.row.name: child.pid
            for child in launcher.children
            if child.row.name in launcher.pages and self._watched(child.row.name)
        }
        messages = self._to_recorder(launcher)
        if not lives:
            return messages
        message = self._figures.message(
            launcher.cpu_s(),
            launcher_cpu_s=launcher_cpu_s(),
            running_ns=launcher.switch.running_ns(launcher.started_ns, now_ns),
            now_ns=now_ns,
        )
        for name, pid in lives.items():
            events = self._events(name, pid)
            messages[name] = msgspec.json.encode(msgspec.structs.replace(message, events=events))
        return messages

    def _events(self, process: str, pid: int | None) -> list[Event]:
        life, number = self._told.get(process, (pid, 0))
        events = self._figures.log.after(number if life == pid else 0)
        self._newest[process] = pid, events[-1].number if events else number
        return events

    def _to_recorder(self, launcher: Launcher) -> dict[str, bytes]:
        gauges = self._collector.process(RECORDER).gauges(RecorderGauges)
        if gauges is None or not gauges.file:
            return {}
        (pid,) = (child.pid for child in launcher.children if child.row.name == RECORDER)
        events = self._events(RECORDER, pid)
        return {RECORDER: msgspec.json.encode(SessionEvents(events=events))} if events else {}

    def handle_sent(self, process: str) -> None:
        """The process has got the newest message."""
        self._told[process] = self._newest[process]

    def _watched(self, process: str) -> bool:
        gauges = self._collector.process(process).gauges(PageGauges)
        return gauges is not None and gauges.watching > 0
