"""Rows of runs: every step is kept once, and a long session's are not told again and again."""

import pickle

from kontur_av.figures import over, plus
from pipelines.mission.figures import TaskFigures
from pipelines.session.task_journal import KEPT, OPEN, LinkMeanwhile, TaskJournal
from telepresence.tasks.experiment import Logged, RunStep, TaskRun
from telepresence.tmtc.k2aci import TaskResult

LINK = LinkMeanwhile(0, 0, 0)


def begin(journal, run):
    journal.handle_begin(LINK)
    for step in list(RunStep)[:-1]:
        journal.handle_event(Logged(run * 100, run, "line", step), LINK)


def end(journal, run):
    over = TaskRun(
        task="line",
        run=run,
        result=TaskResult.FINISHED,
        reason="",
        selected_ns=run * 100,
        started_ns=run * 100,
        ended_ns=run * 100 + 50,
    )
    journal.handle_event(over, LINK)
    journal.handle_event(Logged(run * 100 + 60, run, "line", RunStep.SEEN), LINK)


def test_a_row_has_the_step_that_comes_after_its_end():
    journal = TaskJournal()
    begin(journal, 1)
    assert [row.result for row in journal.report()] == [OPEN]
    end(journal, 1)
    (row,) = journal.report()
    assert [one.step for one in row.steps] == [step.value for step in RunStep]
    assert TaskJournal(journal.closed).report() == [row]


def told_of(journal):
    return TaskFigures(runs={row.run: row for row in journal.newest(KEPT)})


def test_what_is_told_and_kept_does_not_grow_and_the_collector_has_all():
    journal, told, sizes = TaskJournal(), None, []
    for run in range(1, 200):
        begin(journal, run)
        if run % 3:
            gauges = told_of(journal)
            told = gauges if told is None else over(gauges, told)
        end(journal, run)
        gauges = told_of(journal)
        told = gauges if told is None else over(gauges, told)
        sizes.append(len(pickle.dumps(gauges)))
    assert [row.run for row in told.runs.values()] == list(range(1, 200))
    assert {row.result for row in told.runs.values()} == {"finished"}
    assert len(journal.closed) == KEPT and max(sizes) < 60_000


def test_a_run_that_a_killed_process_did_keeps_the_steps_that_were_told():
    before = TaskJournal()
    begin(before, 1)
    told = told_of(before)
    after = TaskJournal()
    after.handle_event(
        TaskRun(
            task="line",
            run=1,
            result=TaskResult.ABORTED,
            reason="killed",
            selected_ns=100,
            started_ns=None,
            ended_ns=200,
        ),
        LINK,
    )
    (row,) = plus(told, told_of(after)).runs.values()
    assert row.result == "aborted" and len(row.steps) == len(RunStep) - 1
