"""Figures and verdict of a pass with a plan of tasks."""

import pytest
from partial_report import partial_report

from pipelines.session.task_journal import STEPS
from pipelines.virtual.campaign.figures import (
    task_faults,
    task_names,
    task_numbers,
)
from telepresence.tasks.plan import PlannedTask, SessionPlan


def run(name="aiming", result="finished", seconds=20.0, steps=STEPS):
    return {
        "name": name,
        "run": 1,
        "result": result,
        "reason": "",
        "selected_ns": 0,
        "seconds": seconds,
        "path_m": 1.0,
        "force_max_n": 1.0,
        "force_mean_n": 1.0,
        "error_mean": None,
        "error_max": None,
        "frames": 1000,
        "frames_lost": 0,
        "delay_ms": 10.0,
        "steps": [{"at_ns": 1_000_000_000, "step": step} for step in steps],
    }


def of(*runs, seconds=100.0, signal_s=100.0):
    """A pass with a signal from its beginning, for `signal_s`."""
    lost_ns = None if signal_s == seconds else round(signal_s * 1e9)
    gateway = {
        "supervision": {
            "counts": {"signals_acquired": 1},
            "contact_ns": signal_s * 1e9,
            "contacts": [{"acquired_ns": 0, "connected_ns": None, "lost_ns": lost_ns}],
        },
        "radio": {"frames_hit": 0, "contact": {"usable_from_s": 0.0, "usable_to_s": signal_s}},
    }
    haptic = {"sent": 1, "received": 1, "pauses_s": [], "latency_ms": {"count": 1}}
    body = {
        "seconds": seconds,
        "streams": {},
        "haptic": {"up": haptic, "down": haptic},
        "link": {},
        "gateways": {"ground": gateway, "space": gateway},
        "skew_ms": {},
        "failures": [],
        "tasks": list(runs),
    }
    return partial_report(body)


def test_a_pass_is_usable_if_a_task_is_finished_in_the_order_of_the_steps():
    early = run(result="lost_signal", seconds=None, steps=(*STEPS[:4], STEPS[8]))
    assert task_faults(of(run(), early)) == []
    assert task_faults(of(early)) == ["no task finished"]
    assert task_faults(of()) == ["no task finished"]


@pytest.mark.parametrize(
    "steps",
    [
        (*STEPS[:3], STEPS[4], STEPS[3], *STEPS[5:]),
        (*STEPS[:3], STEPS[2], *STEPS[3:]),
        STEPS[:-2],
        (*STEPS[:5], *STEPS[6:]),
    ],
)
def test_a_step_in_another_place_or_twice_or_left_out_of_a_finished_run_is_a_fault(steps):
    assert task_faults(of(run(steps=steps))) == ["out of order"]


def test_the_panel_may_learn_of_a_lost_run_after_its_end_but_in_order():
    told, shown, ended, last = STEPS[:3], STEPS[3], STEPS[9:11], STEPS[11]
    at_start = STEPS[4]
    for steps in ((*told, *ended, shown, last), (*told, shown, *ended, at_start)):
        late = run(result="lost_signal", seconds=None, steps=steps)
        assert task_faults(of(run(), late)) == []
    for steps in (
        (*told, *ended, last, shown),
        (*told, *ended, shown, shown),
        (*ended, *told, shown),
    ):
        wrong = run(result="lost_signal", seconds=None, steps=steps)
        assert task_faults(of(run(), wrong)) == ["out of order"]


def test_the_last_step_may_miss_the_contact():
    assert task_faults(of(run(steps=STEPS[:-1]))) == []


def test_a_run_that_is_open_long_after_the_signal_was_lost_is_left_hanging():
    open_one = run(result="open", seconds=None, steps=STEPS[:3])
    assert "left hanging" in task_faults(of(run(), open_one, signal_s=60.0))
    assert "left hanging" not in task_faults(of(run(), open_one, signal_s=80.0))
    assert task_faults(of(run(), open_one)) == []


def test_a_task_has_the_median_time_of_its_finished_runs():
    plan = SessionPlan(tasks=(PlannedTask(name="aiming"), PlannedTask(name="line")))
    done = of(run(seconds=20.0), run(seconds=23.0), run("line", "timed_out", 60.0, STEPS[:9]))
    assert task_names(plan) == ("tasks_begun", "tasks_finished", "aiming_s", "line_s")
    assert task_numbers(done) == {"tasks_begun": 3, "tasks_finished": 2, "aiming_s": 21.5}
    assert task_names(None) == ()
