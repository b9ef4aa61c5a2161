"""Rows of runs: every step is kept once, and a long session's are not told again and again."""

import pickle

from kontur_av.metrics import over, plus
from pipelines.mission.mission_metrics import TaskMetrics
from pipelines.session.task_journal import KEPT, OPEN, LinkMeanwhile, TaskJournal
from telepresence.tasks.experiment import Logged, RunStep, TaskRun
from telepresence.tmtc.k2aci import TaskResult

LINK = LinkMeanwhile(0, 0, 0)


def begin(journal, run):
    journal.handle_begin(LINK)
    for step in list(RunStep)[:-1]:
        journal.handle_event(Logged(run * 100, run, "line", step), LINK)


def end(journal, run, result=TaskResult.FINISHED):
    began_ns = run * 100
    instants = {"selected_ns": began_ns, "started_ns": began_ns, "ended_ns": began_ns + 50}
    ended = TaskRun(task="line", run=run, result=result, reason="", **instants)
    journal.handle_event(ended, LINK)


def told_of(journal):
    return TaskMetrics(runs={row.run: row for row in journal.newest(KEPT)})


def test_a_row_has_every_step_and_what_is_told_and_kept_does_not_grow():
    journal = TaskJournal()
    begin(journal, 1)
    assert [row.result for row in journal.report()] == [OPEN]
    end(journal, 1)
    journal.handle_event(Logged(160, 1, "line", RunStep.SEEN), LINK)
    (row,) = journal.report()
    assert [one.step for one in row.steps] == [step.value for step in RunStep]
    assert TaskJournal(journal.closed).report() == [row]
    before, after = TaskJournal(), TaskJournal()
    begin(before, 1)
    end(after, 1, TaskResult.ABORTED)
    (row,) = plus(told_of(before), told_of(after)).runs.values()
    assert row.result == "aborted" and len(row.steps) == len(RunStep) - 1
    journal, told, sizes = TaskJournal(), TaskMetrics(runs={}), []
    for run in range(1, 200):
        begin(journal, run)
        if run % 3:
            told = over(told_of(journal), told)
        end(journal, run)
        told = over(told_of(journal), told)
        sizes.append(len(pickle.dumps(told_of(journal))))
    assert [row.run for row in told.runs.values()] == list(range(1, 200))
    assert {row.result for row in told.runs.values()} == {"finished"}
    assert len(journal.closed) == KEPT and max(sizes) < 60_000
