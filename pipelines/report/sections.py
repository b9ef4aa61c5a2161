"""What single processes report, for the report and for the live view. A core.

Who drove the robot, what a trainer did, the runs of tasks, the leg to a partner, the recording and
the clocks of two machines.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import msgspec

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.meters import Histogram
from pipelines.media.media_metrics import DisplayMetrics
from pipelines.mission.mission_metrics import ComponentMetrics, TaskMetrics
from pipelines.partner.partner_metrics import RtcMetrics
from pipelines.recording.recorder_metrics import RecorderMetrics
from pipelines.report import model
from pipelines.report.collector import Collector, ProcessMetrics
from pipelines.report.silence import Silence
from pipelines.session.session_metrics import DatedEvent, TrainerMetrics
from pipelines.session.setup.segments import Segment
from pipelines.session.task_journal import TaskRow
from pipelines.session.topology.topics import (
    RTC,
    RTC_CAMERA,
    RTC_DISPLAY,
    RTC_VOICE,
    SECOND_ROBOT,
    TASKS,
    TRAINER,
    component_process,
)
from telepresence.haptics.authority import AuthorityMetrics
from telepresence.haptics.haptic_metrics import PortMetrics, SamplesReceived, SamplesSent
from telepresence.link.link_metrics import ClockMetrics


def arm_report(collector: Collector, epoch_ns: int) -> AuthorityMetrics | None:
    """Return who drove the robot; None where only the joystick in space may.

    epoch_ns: the beginning of the session.
    """
    arm = collector.process("robot").find(AuthorityMetrics)
    if arm is None:
        return None
    events = tuple(replace(event, at_ns=event.at_ns - epoch_ns) for event in arm.events)
    return replace(arm, events=events)


def second_arm_report(collector: Collector) -> model.SecondArmReport | None:
    """Return the figures of a partner's own arm; None without one."""
    if collector.topology.setup.partner_arm != "second":
        return None
    arm = collector.process(SECOND_ROBOT)
    return model.SecondArmReport(
        sender=arm.total(SamplesSent),
        receiver=arm.total(SamplesReceived),
        port=arm.total(PortMetrics),
    )


def exercises(collector: Collector, epoch_ns: int) -> list[DatedEvent] | None:
    """Return what the trainer did; None if nothing."""
    told = collector.process(TRAINER).total(TrainerMetrics).exercises
    return [replace(event, at_ns=event.at_ns - epoch_ns) for event in told] or None


def component_reports(collector: Collector, epoch_ns: int) -> dict[str, ComponentMetrics] | None:
    """Return what the components in telemetry did, by name; None without one that ran here."""
    found = {}
    for component in collector.topology.options.components:
        name = component.application.name
        told = collector.process(component_process(name)).find(ComponentMetrics)
        if told is not None:
            events = (replace(event, at_ns=event.at_ns - epoch_ns) for event in told.events)
            found[name] = replace(told, events=tuple(events))
    return found or None


def task_runs(collector: Collector, epoch_ns: int) -> list[TaskRow] | None:
    """Return the runs of tasks, oldest first; None for a session without tasks."""
    told = collector.process(TASKS).find(TaskMetrics)
    if told is None:
        return None
    return [run_since(epoch_ns, run) for _, run in sorted(told.runs.items())]


def run_since(epoch_ns: int, run: TaskRow) -> TaskRow:
    change = msgspec.structs.replace
    steps = [change(step, at_ns=step.at_ns - epoch_ns) for step in run.steps]
    return change(run, selected_ns=run.selected_ns - epoch_ns, steps=steps)


def task_warnings(collector: Collector) -> list[model.Warning]:
    """Runs that should have a file of their own, and have none."""
    told = collector.process(TASKS).total(TaskMetrics)
    if not told.unrecorded:
        return []
    why = f": {told.unrecorded_why}" if told.unrecorded_why else ""
    return [
        model.Warning(
            what="not_recorded",
            where=TASKS,
            measured=f"{told.unrecorded} runs have no recording of their own{why}",
            fix="with --runs, let nobody else record the session",
        )
    ]


def spread_ms(histogram: Histogram) -> model.Spread:
    """Percentiles of values in ns, in ms; to the microsecond, because more would be noise."""
    summary = histogram.summary_ms()
    return model.Spread(
        **{name: round(summary[name], 3) for name in ("p50", "p95", "p99", "max")},
        p99_9=round(histogram.percentile(99.9) / NS_PER_MS, 3),
        mean=round(histogram.mean / NS_PER_MS, 3),
        count=histogram.count,
    )


def rtc_report(collector: Collector, seconds: float) -> model.RtcReport | None:
    """The leg of a session of `seconds`; None without one."""
    if collector.topology.setup.rtc is None:
        return None
    metrics = collector.process(RTC).find(RtcMetrics)
    if metrics is None:
        return None
    return model.RtcReport(
        metrics=metrics,
        mean_bps={
            name: round(8 * stream.octets / max(seconds, 1e-9))
            for name, stream in sorted(metrics.streams.items())
        },
        shown={
            name: model.RtcShownReport(
                display=collector.process(RTC_DISPLAY).total(DisplayMetrics, name),
                latency_ms=spread_ms(collector.partner[name]),
            )
            for name in (RTC_CAMERA, RTC_VOICE)
        },
    )


def rtc_now(collector: Collector, now_ns: int) -> dict[str, int | float | str | None]:
    """The partner as the pages of the ground show it; empty without a leg."""
    leg = collector.topology.setup.rtc
    if leg is None:
        return {}
    told = collector.process(RTC).total(RtcMetrics)
    trip_ns = told.round_trip_ns
    found: dict[str, int | float | str | None] = {
        "rtc.partners": told.partners,
        "rtc.route": told.route,
        "rtc.round_trip_ms": None if trip_ns is None else round(trip_ns / NS_PER_MS, 3),
        "rtc.rate_bps": told.rate_bps or None,
    }
    display = collector.process(RTC_DISPLAY)
    for name in (RTC_CAMERA, RTC_VOICE):
        shown = display.total(DisplayMetrics, name)
        age_ns = None if shown.age_ns is None else shown.age_ns + max(0, now_ns - display.told_ns)
        found[f"{name}.age_ms"] = None if age_ns is None else round(age_ns / NS_PER_MS, 1)
        found[f"{name}.displayed"] = shown.frames_displayed
    return found


def rtc_line(collector: Collector) -> str | None:
    """A line for the live view; None without a leg or a partner."""
    told = collector.process(RTC).total(RtcMetrics)
    if not told.partners:
        return None
    trip_ns = told.round_trip_ns
    trip = "" if trip_ns is None else f", round trip {trip_ns / NS_PER_MS:.0f} ms"
    route = "" if told.route is None else f" by {told.route}"
    rate = f"{told.rate_bps / 1000:g} kbit/s"
    return f"partner: {told.partners} connections{route}{trip}, picture at {rate}"


RECORDER = "recorder"
_DISK = "give the recording a larger or a faster disk"
_PROCESSOR = "leave the recorder more of the processors: fewer cameras, or a faster machine"


def recorder_report(collector: Collector) -> RecorderMetrics | None:
    """The recording of a session; None if nothing was recorded."""
    metrics = _metrics(collector)
    return metrics if metrics.parts or metrics.disk_faults else None


def seat_recording(collector: Collector) -> dict[str, str | int | None]:
    """What pages show of the recording, by name. file: null while nothing is recorded."""
    if collector.process(RECORDER).find(RecorderMetrics) is None:
        return {}
    metrics = _metrics(collector)
    return {
        "file": (metrics.file or "").rpartition("/")[2] if metrics.recording else None,
        "octets": metrics.octets,
        "lost": metrics.lost,
        "fault": metrics.fault,
    }


def recorder_warnings(collector: Collector) -> list[model.Warning]:
    """What is not in the recording, and whether the disk or the processors were too slow for it.

    A disk makes the recorder drop what it has read. What was gone before it was read is missing
    because the recorder did not run in time.
    """
    metrics = _metrics(collector)
    if not (metrics.lost or metrics.disk_faults):
        return []
    why = f"; {metrics.fault}" if metrics.fault else ""
    dropped = sum(channel.dropped for channel in metrics.channels.values())
    missed = metrics.lost - dropped
    measured = f"{metrics.lost} messages are not in the recording"
    if missed:
        measured += f", of which {missed} were gone before they were read"
    fixes = [_DISK] * bool(dropped or metrics.disk_faults) + [_PROCESSOR] * bool(missed)
    fix = "; ".join(fixes)
    return [model.Warning(what="not_recorded", where=RECORDER, measured=measured + why, fix=fix)]


def recording_line(collector: Collector) -> tuple[str, bool] | None:
    """A line for the live view, and whether it is bad news; None while nothing is recorded."""
    metrics = _metrics(collector)
    if not metrics.recording:
        return None
    line = f"recording to {metrics.file}, {metrics.octets / 1e6:.1f} MB"
    line += f", {metrics.lost} messages lost" if metrics.lost else ""
    line += f": {metrics.fault}" if metrics.fault else ""
    return line, bool(metrics.lost or metrics.fault)


def _metrics(collector: Collector) -> RecorderMetrics:
    return collector.process(RECORDER).total(RecorderMetrics)


def clock_words(peer: str, clock: ClockMetrics) -> str:
    """One line: where the clock of `peer`, a segment, is, with the error."""
    if clock.offset_ns is None or clock.error_ns is None:
        return f"clock: {peer}'s is not known"
    error_ms = clock.error_ns / NS_PER_MS
    words = f"clock: {peer} is {clock.offset_ns / NS_PER_S:+.6f} s ± {error_ms:.2f} ms"
    if clock.drift_ppb is not None and clock.drift_error_ppb is not None:
        words += f", drift {clock.drift_ppb / 1000:.1f} ± {clock.drift_error_ppb / 1000:.1f} ppm"
    if clock.restarts:
        words += f"; stepped {clock.restarts} times"
    return words


def clock_lines(collector: Collector) -> Iterator[str]:
    """The line of each gateway of this session whose peer is on another machine."""
    for segment in Segment:
        link = collector.gateway(segment).link
        if link is not None and link.clock is not None:
            yield clock_words(segment.peer.value, link.clock)


def cpu_report(
    cpu_s: Mapping[str, float], launcher_cpu_s: float, seconds: float
) -> model.CpuReport:
    total_s = sum(cpu_s.values()) + launcher_cpu_s
    return model.CpuReport(
        total_s=round(total_s, 2),
        launcher_s=round(launcher_cpu_s, 2),
        cores_used=round(total_s / max(seconds, 1e-9), 3),
    )


def process_report(
    metrics: ProcessMetrics, cpu_s: float, restarts: int, silence: Silence | None = None
) -> model.ProcessReport:
    """One process, with the CPU time and restarts that its launcher knows.

    silence: of an input that delivers nothing.
    """
    return model.ProcessReport(
        cpu_s=round(cpu_s, 3),
        restarts=restarts,
        source_fault=metrics.capture.source_fault if silence is None else silence.fault or None,
        scheduler=metrics.scheduler,
        last_error=metrics.last_error,
        silent_s=None if silence is None else round(silence.silent_ns / NS_PER_S, 1),
        counts=metrics.counts_by_name(),
        newest=metrics.newest_by_name(),
    )
