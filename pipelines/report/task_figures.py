"""The runs of tasks for the report. A core."""

from collections.abc import Sequence

from kontur_av.clock import NS_PER_S
from pipelines.report.collector import Collector
from pipelines.report.model import TaskRunReport, TaskStepReport, Warning
from pipelines.session.figures import TaskCounters, TaskGauges
from pipelines.session.task_journal import TaskRow
from pipelines.session.topology import TASKS


def task_report(rows: Sequence[TaskRow], epoch_ns: int) -> list[TaskRunReport]:
    """Return the rows with instants since `epoch_ns`, the beginning of the session."""

    def seconds(instant_ns: int) -> float:
        return round((instant_ns - epoch_ns) / NS_PER_S, 3)

    return [
        TaskRunReport(
            name=row.name,
            run=row.run,
            result=row.result,
            reason=row.reason,
            selected_s=seconds(row.selected_ns),
            seconds=row.seconds,
            path_m=row.path_m,
            force_max_n=row.force_max_n,
            force_mean_n=row.force_mean_n,
            error_mean=row.error_mean,
            error_max=row.error_max,
            frames=row.frames,
            frames_lost=row.frames_lost,
            delay_ms=row.delay_ms,
            steps=[TaskStepReport(at_s=seconds(one.at_ns), step=one.step) for one in row.steps],
        )
        for row in rows
    ]


def live_task_report(collector: Collector, epoch_ns: int) -> list[TaskRunReport] | None:
    """Return the runs of a live session; None for one without tasks."""
    gauges = collector.process(TASKS).gauges(TaskGauges)
    return None if gauges is None else task_report(gauges.rows, epoch_ns)


def task_warnings(collector: Collector) -> list[Warning]:
    """Runs that should have a file of their own, and have none."""
    figures = collector.process(TASKS)
    count, gauges = figures.total(TaskCounters).unrecorded, figures.gauges(TaskGauges)
    if not count:
        return []
    why = f": {gauges.unrecorded_why}" if gauges is not None and gauges.unrecorded_why else ""
    return [
        Warning(
            what="not_recorded",
            where=TASKS,
            measured=f"{count} runs have no recording of their own{why}",
            mend="with --runs, let nobody else record the session",
        )
    ]
