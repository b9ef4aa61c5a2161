"""The figures of both seats' pages, made by the functions that make the report. A core.

A figure has the name that its key has in the report, without `streams.`: `uplink_video.cap_bps`.
These have none there:

| figure | what |
|---|---|
| STREAM.`age_ms`, `state` | how old what is shown is, and whether it is fresh |
| STREAM.`rate_bps`, `haptic.`WAY`.rate_bps` | the rate of the last second |
| `skew_limits_ms.`NAME`.least`, `.most` | what people do not notice |
| `hand.holder` | the page that holds the handle |
| `rtc.partners`, `rtc_camera.displayed` | a partner's connections, its pictures that were shown |
| `tmtc.`END`.`COUNT | telecommands, telemetry and K2ACI of an end (`TmtcMetrics`) |
| `contact.since_acquisition_s`, `contact.until_loss_s` | the present instant in the pass |
| `contact.ahead`, `contact.ahead_s` | what the pass brings next, and in how long |
| `upkeep.experiment`, `upkeep.short` | what runs; where bandwidth is short; null for nothing |
"""

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any, Literal

import msgspec

from kontur_av.clock import NS_PER_MS, NS_PER_S, NS_PER_US
from pipelines.mission.mission_metrics import TmtcMetrics
from pipelines.report.collector import Collector
from pipelines.report.event_log import EventLog
from pipelines.report.link_report import gateway_metrics, link_metrics
from pipelines.report.model import DirectionReport, GatewayReport, to_builtins
from pipelines.report.sections import cpu_report, process_report, rtc_now, seat_recording
from pipelines.report.session_report import (
    haptic_report,
    joystick_report,
    skew_reports,
    stream_report,
)
from pipelines.report.silence import last_bps, shown_now, silences
from pipelines.report.sync_metrics import LIMITS
from pipelines.seats.page_metrics import HOLDER, PageMetrics
from pipelines.session.session_metrics import Event, gathered
from pipelines.session.session_switch import Activity, SessionSwitch
from pipelines.session.setup.segments import Segment
from pipelines.session.topology.topics import PAGES
from pipelines.session.verdict import ProcessNow

Figure = int | float | str | bool | None

#: Over how long the share of a core that a process takes is measured.
_CPU_NS = 2 * NS_PER_S
#: What a page does not show, because it never changes.
_LEFT_OUT = {"arithmetic", "needed_at_caps_bps"}
#: By end: the process that has its telecommands and telemetry.
_TMTC_ENDS = {"space": "console", "ground": "selector"}
_PERCENTILES = ("p50", "p95", "p99", "p99.9", "max", "mean")


class SeatProcess(msgspec.Struct, frozen=True, kw_only=True):
    """A process. cpu: share of a core over the last 2 s; None: not known yet. trouble: why it does
    not do its work; "" if it does.
    """

    name: str
    segment: str | None
    cpu: float | None
    restarts: int
    running: bool
    error: str
    trouble: str


class SeatDirection(msgspec.Struct, frozen=True, kw_only=True):
    """A direction of the link, counted since the session began.

    octets: by what they carried. drops: packets, by level. lost: frames.
    """

    octets: Mapping[str, int]
    drops: Mapping[str, int]
    lost: int
    slips: int


class SeatMessage(msgspec.Struct, frozen=True, kw_only=True, tag_field="kind", tag="figures"):
    """What a page gets twice a second.

    at_us: on the session's clock. seconds: since the session began.
    """

    at_us: int
    seconds: float
    state: Literal["running", "stopped"]
    figures: Mapping[str, Figure]
    link: Mapping[str, SeatDirection]
    processes: Sequence[SeatProcess]
    events: Sequence[Event]


class SeatMetrics:
    """Makes the messages. Call `handle_look` about twice a second, also while nobody watches."""

    def __init__(self, collector: Collector) -> None:
        self.log = EventLog(collector)
        self._collector = collector
        self._topology = collector.topology
        self._processes: Sequence[ProcessNow] = ()
        self._activity = Activity.RUNNING
        self._started_ns = 0
        #: Instants with the CPU seconds of each process; the oldest is at least 2 s old, if any is.
        self._cpu_s: deque[tuple[int, Mapping[str, float]]] = deque()

    def handle_look(
        self,
        processes: Sequence[ProcessNow],
        *,
        switch: SessionSwitch,
        started_ns: int,
        now_ns: int,
    ) -> None:
        """Note what happened. started_ns: when the session began."""
        self._processes, self._activity, self._started_ns = processes, switch.activity, started_ns
        self.log.handle_look(processes, switch=switch, started_ns=started_ns, now_ns=now_ns)

    def message(
        self, cpu_s: Mapping[str, float], *, launcher_cpu_s: float, running_ns: int, now_ns: int
    ) -> SeatMessage:
        """The message of this instant, without events.

        cpu_s: of each process since the session began. running_ns: how long it was not stopped.
        """
        ends = {
            end.value: gateway_metrics(self._collector, end.value)
            for end in self._topology.segments
        }
        directions = {
            link.direction.value: link_metrics(self._collector, link.direction.value)
            for link in self._topology.links
        }
        seconds = running_ns / NS_PER_S
        metrics = dict(self._metrics(directions, ends, seconds, now_ns))
        total = cpu_report(cpu_s, launcher_cpu_s, seconds)
        metrics |= _flat("cpu", to_builtins(total))
        silent = {silence.process: silence for silence in silences(self._collector)}
        for process in self._processes:
            spent_s = cpu_s.get(process.name, 0.0)
            told = self._collector.process(process.name)
            report = process_report(told, spent_s, process.restarts, silent.get(process.name))
            metrics |= _flat(f"processes.{process.name}", to_builtins(report))
        return SeatMessage(
            at_us=now_ns // NS_PER_US,
            seconds=round((now_ns - self._started_ns) / NS_PER_S, 3),
            state="running" if self._activity is Activity.RUNNING else "stopped",
            figures=metrics,
            link={name: _direction(report) for name, report in directions.items()},
            processes=list(self._seat_processes(cpu_s, now_ns)),
            events=(),
        )

    def _metrics(
        self,
        directions: Mapping[str, DirectionReport],
        ends: Mapping[str, GatewayReport],
        seconds: float,
        now_ns: int,
    ) -> Iterator[tuple[str, Figure]]:
        collector = self._collector
        for stream in collector.setup.streams:
            report = stream_report(stream, collector, seconds)
            yield from _flat(stream.name, to_builtins(report)).items()
            state, age_ns = shown_now(stream, collector, now_ns)
            age_ms = None if age_ns is None else round(age_ns / NS_PER_MS, 1)
            yield f"{stream.name}.age_ms", age_ms
            yield f"{stream.name}.state", state.value
            rate_bps = last_bps(collector.streams[stream.name].rate, now_ns)
            yield f"{stream.name}.rate_bps", round(rate_bps)
        for row in self._topology.haptics:
            name = f"haptic.{row.key}"
            samples = haptic_report(row, collector, seconds)
            yield from _flat(name, to_builtins(samples)).items()
            rate_bps = last_bps(collector.haptics[row.key].rate, now_ns)
            yield f"{name}.rate_bps", round(rate_bps)
        for name, skew in skew_reports(collector).items():
            yield from _flat(f"skew_ms.{name}", to_builtins(skew)).items()
            yield f"skew_limits_ms.{name}.least", LIMITS[name].least_ns / NS_PER_MS
            yield f"skew_limits_ms.{name}.most", LIMITS[name].most_ns / NS_PER_MS
        yield from _flat("joystick", to_builtins(joystick_report(collector))).items()
        seat = collector.process(PAGES[Segment.SPACE]).find(PageMetrics)
        for name, figure in seat_recording(collector).items():
            yield f"recorder.{name}", figure
        yield HOLDER, (seat.holder or None) if seat is not None else None
        yield from rtc_now(collector, now_ns).items()
        for segment, process in _TMTC_ENDS.items():
            counts = asdict(collector.process(process).total(TmtcMetrics))
            yield from _flat(f"tmtc.{segment}", counts).items()
        for name, direction in directions.items():
            yield from _flat(f"link.{name}", to_builtins(direction)).items()
        for name, end in ends.items():
            yield from _flat(f"gateways.{name}", to_builtins(end)).items()
        contact = next(iter(ends.values())).contact
        if contact is not None:
            pass_s = collector.setup.radio_profile.start_s + (now_ns - self._started_ns) / NS_PER_S
            yield "contact.since_acquisition_s", round(pass_s - contact.acquisition_s, 1)
            yield "contact.until_loss_s", round(contact.loss_s - pass_s, 1)
        upkeep = self.log.upkeep
        what, left_s = upkeep.next or (None, None)
        yield "contact.ahead", what
        yield "contact.ahead_s", None if left_s is None else round(left_s, 1)
        yield "upkeep.experiment", upkeep.experiment or None
        yield "upkeep.short", upkeep.short or None

    def _seat_processes(self, cpu_s: Mapping[str, float], now_ns: int) -> Iterator[SeatProcess]:
        looks = self._cpu_s
        # Nobody has watched for a while: those times say nothing of the last 2 s.
        if looks and looks[-1][0] < now_ns - _CPU_NS:
            looks.clear()
        looks.append((now_ns, cpu_s))
        while len(looks) > 1 and looks[1][0] <= now_ns - _CPU_NS:
            looks.popleft()
        before_ns, before_s = looks[0]
        for process in self._processes:
            cpu = None
            if now_ns > before_ns and process.name in before_s:
                spent_s = cpu_s[process.name] - before_s[process.name]
                cpu = round(spent_s * NS_PER_S / (now_ns - before_ns), 3)
            segment = self._topology.process(process.name).segment
            place = None if segment is None else segment.value
            yield gathered(SeatProcess, process, segment=place, cpu=cpu)


def _direction(report: DirectionReport) -> SeatDirection:
    return SeatDirection(
        octets=report.sender.octets,
        drops={level: sum(queue.drops.values()) for level, queue in report.sender.queue.items()},
        lost=report.receiver.frames_lost,
        slips=report.loop.slips,
    )


def _flat(prefix: str, value: Any) -> dict[str, Figure]:
    """Names and values of all but lists. Percentiles of nothing have no value."""
    if not isinstance(value, dict):
        return {} if isinstance(value, list | tuple) else {prefix: value}
    found: dict[str, Figure] = {}
    empty = value.get("count") == 0
    for key, below in value.items():
        if key in _LEFT_OUT:
            continue
        found |= _flat(f"{prefix}.{key}", None if empty and key in _PERCENTILES else below)
    return found
