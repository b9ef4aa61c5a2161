"""The sections of a report that single processes fill. A core.

The processes themselves and their CPU time; who drove the robot, what a trainer did, the runs of
tasks, the leg to a partner and the recording. `epoch_ns` is the beginning of the session, from
which a report counts its instants.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, TypeVar

import msgspec

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.meters import Histogram
from pipelines.media.media_metrics import DisplayMetrics, SelectorMetrics
from pipelines.mission.mission_metrics import ComponentMetrics, TaskMetrics
from pipelines.partner.partner_metrics import RtcMetrics
from pipelines.recording.recorder_metrics import RecorderMetrics
from pipelines.report import model
from pipelines.report.collector import Collector
from pipelines.report.silence import Silence
from pipelines.session.session_metrics import DatedEvent, ProcessNow, TrainerMetrics
from pipelines.session.task_journal import TaskRow
from pipelines.session.topology.topics import (
    RECORDER,
    RTC,
    RTC_CAMERA,
    RTC_DISPLAY,
    RTC_VOICE,
    SECOND_ROBOT,
    SELECTOR,
    TASKS,
    TRAINER,
    component_process,
)
from telepresence.haptics.haptic_metrics import PortMetrics, SamplesReceived, SamplesSent

_DISK = "give the recording a larger or a faster disk"
_PROCESSOR = "leave the recorder more of the processors: fewer cameras, or a faster machine"

RecordT = TypeVar("RecordT")


def cpu_report(
    processes: Sequence[ProcessNow], launcher_cpu_s: float, seconds: float
) -> model.CpuReport:
    total_s = sum(process.cpu_s for process in processes) + launcher_cpu_s
    return model.CpuReport(
        total_s=round(total_s, 2),
        launcher_s=round(launcher_cpu_s, 2),
        cores_used=round(total_s / max(seconds, 1e-9), 3),
    )


def process_report(
    process: ProcessNow, collector: Collector, silence: Silence | None = None
) -> model.ProcessReport:
    """One process. silence: of an input that delivers nothing."""
    metrics = collector.process(process.name)
    return model.ProcessReport(
        cpu_s=round(process.cpu_s, 3),
        restarts=process.restarts,
        source_fault=metrics.capture.source_fault if silence is None else silence.fault or None,
        scheduler=metrics.scheduler,
        last_error=metrics.last_error,
        silent_s=None if silence is None else round(silence.silent_ns / NS_PER_S, 1),
        counts=metrics.counts_by_name(),
        newest=metrics.newest_by_name(),
    )


def spread_ms(histogram: Histogram) -> model.Spread:
    """Percentiles of values in ns, in ms; to the microsecond, because more would be noise."""
    summary = histogram.summary_ms()
    return model.Spread(
        **{name: round(summary[name], 3) for name in ("p50", "p95", "p99", "max")},
        p99_9=round(histogram.percentile(99.9) / NS_PER_MS, 3),
        mean=round(histogram.mean / NS_PER_MS, 3),
        count=histogram.count,
    )


def dated(record: RecordT | None, epoch_ns: int) -> RecordT | None:
    """Return a record with the instants of its `events` in the session's time."""
    if record is None:
        return None
    events: Sequence[Any] = record.events  # type: ignore[attr-defined]
    return replace(record, events=_since(epoch_ns, events))  # type: ignore[type-var]


def _since(epoch_ns: int, events: Sequence[Any]) -> tuple[Any, ...]:
    return tuple(replace(event, at_ns=event.at_ns - epoch_ns) for event in events)


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
    return [*_since(epoch_ns, told)] or None


def focuses(collector: Collector, epoch_ns: int) -> list[DatedEvent] | None:
    """Return the changes of the focus; None without any."""
    told = collector.process(SELECTOR).total(SelectorMetrics).focuses
    return [*_since(epoch_ns, told)] or None


def component_reports(collector: Collector, epoch_ns: int) -> dict[str, ComponentMetrics] | None:
    """Return what the components in telemetry did, by name; None without one that ran here."""
    names = [component.application.name for component in collector.topology.options.components]
    processes = {name: collector.process(component_process(name)) for name in names}
    found = {name: dated(each.find(ComponentMetrics), epoch_ns) for name, each in processes.items()}
    return {name: record for name, record in found.items() if record is not None} or None


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


def rtc_report(collector: Collector, seconds: float) -> model.RtcReport | None:
    """The leg of a session of `seconds`; None without one."""
    metrics = collector.process(RTC).find(RtcMetrics)
    if metrics is None or collector.topology.setup.rtc is None:
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


def recorder_report(collector: Collector) -> RecorderMetrics | None:
    """The recording of a session; None if nothing was recorded."""
    metrics = collector.process(RECORDER).total(RecorderMetrics)
    return metrics if metrics.parts or metrics.disk_faults else None


def recorder_warnings(collector: Collector) -> list[model.Warning]:
    """What is not in the recording, and whether the disk or the processors were too slow for it.

    A disk makes the recorder drop what it has read. What was gone before it was read is missing
    because the recorder did not run in time.
    """
    metrics = collector.process(RECORDER).total(RecorderMetrics)
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
