"""Joins the reports of the two ends of a session on two machines. A core.

What one end alone counts is taken from its report. What needs both (latencies, stages, skews,
contacts) is found anew, by the collector of a session on one machine, from the rows of both: those
of space with their instants on the clock of the ground (`telepresence.link.clock_estimator`).
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ConfigError, ProtocolError
from kontur_av.metrics import marks_of, plus
from pipelines.recording.recorder_metrics import RecorderMetrics
from pipelines.report import model
from pipelines.report.collector import Collector
from pipelines.report.sections import spread_ms
from pipelines.report.session_report import skew_reports, stream_latency_ms
from pipelines.report.sync_metrics import sync_section
from pipelines.report.terms import video_lead
from pipelines.report.trace import TRACED, rows_of
from pipelines.session.probe import FLUSH_NS, Message, Series
from pipelines.session.session_metrics import INSTANTS, ClockRow, DatedEvent, Row
from pipelines.session.setup.segments import Segment
from pipelines.session.setup.table import Setup
from pipelines.session.topology.table import Topology
from telepresence.link.clock_estimator import ClockHistory

#: A session lasts no longer.
_LONGEST_NS = 7 * 24 * 3600 * NS_PER_S
_NEEDS = "write both with `kontur-av stream --end … --report FILE` of one session"


class JoinedEnd(NamedTuple):
    """The report of an end, and its trace."""

    report: model.SessionReport
    trace: model.EndTrace


@dataclass
class _Timed:
    """Rows of a process in the order of their instants on the ground's clock."""

    process: str
    kind: type[Row]
    stream: str
    rows: NDArray[np.int64]
    instants_ns: NDArray[np.int64]
    taken: int = 0

    def take(self, until_ns: int) -> Series[Any] | None:
        """The next rows, those before `until_ns`."""
        end = int(np.searchsorted(self.instants_ns, until_ns))
        if end == self.taken:
            return None
        rows = self.rows[self.taken : end]
        self.taken = end
        values = array("q", np.ascontiguousarray(rows).tobytes())
        return Series(self.kind, self.stream, values)


def join_reports(
    first: model.SessionReport,
    second: model.SessionReport,
    *,
    read_setup: Callable[[str], Setup],
    table_of: Callable[[Setup], Topology],
) -> model.SessionReport:
    """Return the report of the whole session; the order of the two does not matter.

    read_setup: makes a setup of its TOML text (`pipelines.session.setup.setup_file`).
    table_of: makes its table (`pipelines.table.topology_of`).
    Raises ConfigError if they are not the two ends of one session, and ProtocolError for a trace
    that no session wrote.
    """
    ends = _ends(first, second)
    ground, space = ends[Segment.GROUND], ends[Segment.SPACE]
    setup = read_setup(ground.trace.setup)
    topology = table_of(setup)
    _check_alike(setup, read_setup(space.trace.setup))
    collector = Collector(topology)
    error_ns = _collect(collector, ground.trace, space.trace)
    reports = {segment: end.report for segment, end in ends.items()}
    link = {name: _direction(topology, name, reports) for name in ("uplink", "downlink")}
    began_ns, ended_ns = both_ran_ns = _both_ran(ground.trace, space.trace)
    return msgspec.structs.replace(
        ground.report,
        end=None,
        trace=None,
        seconds=round((ended_ns - began_ns) / NS_PER_S, 3),
        streams={
            stream.name: _stream(stream.name, reports, collector, error_ns, both_ran_ns)
            for stream in setup.streams
        },
        haptic={
            row.key: _haptic(row.key, reports, collector, both_ran_ns) for row in topology.haptics
        },
        joystick=space.report.joystick,
        link=link,
        gateways=ground.report.gateways | space.report.gateways,
        skew_ms=skew_reports(collector),
        video_lead=video_lead(
            setup,
            collector.streams[setup.uplink_video.name].way,
            link["uplink"],
            force_ns=collector.haptics["up"].latency.mean,
            epoch_ns=began_ns,
        ),
        sync=sync_section(setup, collector.sync, media=True),
        lip_sync=collector.lip_sync.summary() if collector.lip_sync.counted_ns else None,
        cpu=_cpu(ground.report.cpu, space.report.cpu),
        processes=ground.report.processes | space.report.processes,
        failures=[*ground.report.failures, *space.report.failures],
        warnings=[*ground.report.warnings, *space.report.warnings],
        exercises=_exercises(ends),
        focus=ends[Segment.GROUND].report.focus,
        recorder=_recorder(ground.report.recorder, space.report.recorder),
        rtc=ground.report.rtc,
    )


def _ends(first: model.SessionReport, second: model.SessionReport) -> dict[Segment, JoinedEnd]:
    ends: dict[Segment, JoinedEnd] = {}
    for report in (first, second):
        if report.end is None or report.trace is None:
            raise ConfigError(f"a report of a whole session, not of an end: {_NEEDS}")
        try:
            segment = Segment(report.end)
        except ValueError:
            raise ConfigError(f"a report of the end {report.end!r}: {_NEEDS}") from None
        if segment in ends:
            raise ConfigError(f"both reports are of the end {report.end}: {_NEEDS}")
        ends[segment] = JoinedEnd(report, report.trace)
    one, other = (end.trace for end in ends.values())
    met = set(one.lives) & set(other.peers) | set(other.lives) & set(one.peers)
    if not met:
        raise ConfigError(f"the two ends never met: the reports are of two sessions; {_NEEDS}")
    return ends


def _check_alike(ground: Setup, space: Setup) -> None:
    for name in ("streams", "uplink", "downlink", "deadband", "hand"):
        if getattr(ground, name) != getattr(space, name):
            raise ConfigError(f"the ends had setups with different {name}; give both the same")


def _collect(collector: Collector, ground: model.EndTrace, space: model.EndTrace) -> int:
    """Give the rows of both ends to the collector; return the largest error of an instant (ns)."""
    history, shift_ns = _clock(ground, space)
    timed, errors_ns = [], [0]
    for trace in (ground, space):
        for series in trace.series:
            found, error_ns = _timed(
                series, collector.topology, None if trace is ground else (history, shift_ns)
            )
            if found is not None:
                timed.append(found)
                errors_ns.append(error_ns)
    _replay(collector, timed)
    return max(errors_ns)


def _clock(ground: model.EndTrace, space: model.EndTrace) -> tuple[ClockHistory, int]:
    """Where the clock of the ground was, by instants of space; what else to add (ns).

    The offsets are between wall times.
    """
    shift_ns = space.wall_offset_ns - ground.wall_offset_ns
    own = _history(space.series)
    if own.known:
        return own, shift_ns
    other = _history(ground.series)
    if not other.known:
        raise ConfigError("neither end knew the other's clock; let the session run for longer")
    # Instants of the wall time of space, brought to the clock of its rows.
    reversed_ = ClockHistory()
    for instant_ns, offset_ns, error_ns in other.estimates():
        at_ns = instant_ns + ground.wall_offset_ns + offset_ns - space.wall_offset_ns
        reversed_.add(at_ns, -offset_ns, error_ns)
    return reversed_, shift_ns


def _history(every: Iterable[model.TraceSeries]) -> ClockHistory:
    history = ClockHistory()
    for series in every:
        if TRACED.get(series.kind) is ClockRow:
            for instant_ns, offset_ns, error_ns in rows_of(series).tolist():
                history.add(instant_ns, offset_ns, error_ns)
    return history


def _timed(
    series: model.TraceSeries, topology: Topology, clock: tuple[ClockHistory, int] | None
) -> tuple[_Timed | None, int]:
    """The rows on the clock of the ground, and the largest error of their instants (ns).

    clock: of rows of space. None for rows that no collector takes.
    """
    rows = rows_of(series)
    kind = TRACED[series.kind]
    known = series.process in {row.name for row in topology.processes}
    of_stream = not series.stream or series.stream in {row.name for row in topology.media_streams}
    if kind is ClockRow or not len(rows) or not (known and of_stream):
        return None, 0
    columns = [kind._fields.index(column) for column in INSTANTS[kind]]
    error_ns = 0
    if clock is not None:
        history, shift_ns = clock
        rows = rows.copy()
        for column in columns:
            offsets_ns, errors_ns = history.at(rows[:, column])
            rows[:, column] += offsets_ns + shift_ns
            error_ns = max(error_ns, int(errors_ns.max()))
    instants_ns = rows[:, columns].max(axis=1)
    order = np.argsort(instants_ns, kind="stable")
    return _Timed(series.process, kind, series.stream, rows[order], instants_ns[order]), error_ns


def _replay(collector: Collector, timed: list[_Timed]) -> None:
    """Tell the collector the rows in the order in which a session would have told them."""
    if not timed:
        return
    now_ns = min(int(one.instants_ns[0]) for one in timed)
    end_ns = max(int(one.instants_ns[-1]) for one in timed)
    if end_ns - now_ns > _LONGEST_NS:
        raise ProtocolError(f"the rows span {(end_ns - now_ns) / NS_PER_S:.0f} s")
    while now_ns <= end_ns:
        now_ns += FLUSH_NS
        for one in timed:
            series = one.take(now_ns)
            if series is not None:
                collector.handle_message(one.process, Message(series=[series]), now_ns)
    # What waits is complete.
    collector.sync.handle_time(now_ns + 2 * NS_PER_S, collector.haptics["up"].sent_ns_at)
    collector.handle_end()


def _both_ran(ground: model.EndTrace, space: model.EndTrace) -> tuple[int, int]:
    """From when to when both ends ran, on the clock of the ground."""
    history, shift_ns = _clock(ground, space)
    instants_ns = np.array([space.began_ns, space.ended_ns], np.int64)
    began_ns, ended_ns = (instants_ns + history.at(instants_ns).offsets_ns + shift_ns).tolist()
    began_ns, ended_ns = max(began_ns, ground.began_ns), min(ended_ns, ground.ended_ns)
    if ended_ns <= began_ns:
        raise ConfigError(f"the two ends did not run at the same time; {_NEEDS}")
    return began_ns, ended_ns


def _received(report: msgspec.Struct) -> Mapping[str, Any]:
    marks = marks_of(type(report))
    return {name: getattr(report, name) for name, one in marks.items() if model.RECEIVED in one}


def _stream(
    name: str,
    reports: Mapping[Segment, model.SessionReport],
    collector: Collector,
    error_ns: int,
    both_ran_ns: tuple[int, int],
) -> model.StreamReport:
    direction = collector.topology.media(name).direction
    sent = reports[direction.sender].streams[name]
    received = reports[direction.receiver].streams[name]
    metrics = collector.streams[name]
    return msgspec.structs.replace(
        sent,
        side=None,
        **_received(received),
        latency_ms=stream_latency_ms(metrics),
        latency_error_ms=round(error_ns / NS_PER_MS, 3),
        pauses_s=metrics.pauses.within_s(*both_ran_ns),
        capture_stamp_error_us=round(metrics.stamp_error.max / 1000, 1),
    )


def _haptic(
    key: str,
    reports: Mapping[Segment, model.SessionReport],
    collector: Collector,
    both_ran_ns: tuple[int, int],
) -> model.HapticReport:
    direction = collector.topology.haptic(key).direction
    sent = reports[direction.sender].haptic[key]
    received = reports[direction.receiver].haptic[key]
    metrics = collector.haptics[key]
    return msgspec.structs.replace(
        sent,
        side=None,
        **_received(received),
        latency_ms=spread_ms(metrics.latency),
        pauses_s=metrics.pauses.within_s(*both_ran_ns),
    )


def _direction(
    topology: Topology, name: str, reports: Mapping[Segment, model.SessionReport]
) -> model.DirectionReport:
    (link,) = (row for row in topology.links if row.direction.value == name)
    received = reports[link.direction.receiver].link[name]
    sent = reports[link.direction.sender].link[name]
    return msgspec.structs.replace(sent, **_received(received))


def _cpu(ground: model.CpuReport, space: model.CpuReport) -> model.CpuReport:
    return model.CpuReport(
        total_s=round(ground.total_s + space.total_s, 2),
        launcher_s=round(ground.launcher_s + space.launcher_s, 2),
        cores_used=round(ground.cores_used + space.cores_used, 3),
    )


def _exercises(ends: Mapping[Segment, JoinedEnd]) -> list[DatedEvent] | None:
    found = [exercise for end in ends.values() for exercise in end.report.exercises or ()]
    return sorted(found, key=lambda one: one.at_ns) or None


def _recorder(
    ground: RecorderMetrics | None, space: RecorderMetrics | None
) -> RecorderMetrics | None:
    """Both recorders; the files of the two are named one after the other."""
    if ground is None or space is None:
        return ground or space
    files = [one.file for one in (ground, space) if one.file is not None]
    return replace(
        plus(_named(ground, "ground"), _named(space, "space")),
        file="; ".join(files) or None,
        fault=ground.fault or space.fault,
    )


def _named(recorder: RecorderMetrics, end: str) -> RecorderMetrics:
    channels = {f"{end}: {name}": channel for name, channel in recorder.channels.items()}
    return replace(recorder, channels=channels)
