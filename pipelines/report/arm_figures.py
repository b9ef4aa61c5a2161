"""Who drove the robot, what a trainer did, and the runs of tasks. A core."""

from dataclasses import replace

import msgspec

from pipelines.mission.figures import TaskFigures
from pipelines.report.collector import Collector
from pipelines.report.model import SecondArmReport, Warning
from pipelines.session.figures import DatedEvent, TrainerFigures
from pipelines.session.task_journal import TaskRow
from pipelines.session.topology import SECOND_ROBOT, TASKS, TRAINER
from telepresence.haptics.figures import PortFigures, SamplesReceived, SamplesSent
from telepresence.haptics.ownership import OwnershipFigures


def arm_report(collector: Collector, epoch_ns: int) -> OwnershipFigures | None:
    """Return who drove the robot; None where only the joystick in space may.

    epoch_ns: the beginning of the session.
    """
    arm = collector.process("robot").find(OwnershipFigures)
    if arm is None:
        return None
    events = tuple(replace(event, at_ns=event.at_ns - epoch_ns) for event in arm.events)
    return replace(arm, events=events)


def second_arm_report(collector: Collector) -> SecondArmReport | None:
    """Return the figures of a partner's own arm; None without one."""
    if collector.topology.setup.partner_arm != "second":
        return None
    arm = collector.process(SECOND_ROBOT)
    return SecondArmReport(
        sender=arm.total(SamplesSent),
        receiver=arm.total(SamplesReceived),
        port=arm.total(PortFigures),
    )


def exercises(collector: Collector, epoch_ns: int) -> list[DatedEvent] | None:
    """Return what the trainer did; None if nothing."""
    told = collector.process(TRAINER).total(TrainerFigures).exercises
    return [replace(event, at_ns=event.at_ns - epoch_ns) for event in told] or None


def task_runs(collector: Collector, epoch_ns: int) -> list[TaskRow] | None:
    """Return the runs of tasks, oldest first; None for a session without tasks."""
    told = collector.process(TASKS).find(TaskFigures)
    if told is None:
        return None
    return [run_since(epoch_ns, run) for _, run in sorted(told.runs.items())]


def run_since(epoch_ns: int, run: TaskRow) -> TaskRow:
    """Return a run with its instants since `epoch_ns`."""
    change = msgspec.structs.replace
    steps = [change(one, at_ns=one.at_ns - epoch_ns) for one in run.steps]
    return change(run, selected_ns=run.selected_ns - epoch_ns, steps=steps)


def task_warnings(collector: Collector) -> list[Warning]:
    """Runs that should have a file of their own, and have none."""
    told = collector.process(TASKS).total(TaskFigures)
    if not told.unrecorded:
        return []
    why = f": {told.unrecorded_why}" if told.unrecorded_why else ""
    return [
        Warning(
            what="not_recorded",
            where=TASKS,
            measured=f"{told.unrecorded} runs have no recording of their own{why}",
            mend="with --runs, let nobody else record the session",
        )
    ]
