"""Fig. 14 from selection to end: every task of the catalogue, and what ends one early."""

from dataclasses import replace

import pytest
from mission import MS, Mission

from telepresence.haptics.board import LIGHTS_M
from telepresence.haptics.sample import MODE_OFF
from telepresence.tasks.cosmonaut import LOOK_NS
from telepresence.tasks.experiment import Phase, RunStep
from telepresence.tasks.panel import MissionPanel
from telepresence.tasks.scores import ScoreKeeper
from telepresence.tmtc.k2aci import (
    Numbered,
    PanelMode,
    TaskFinished,
    TaskResult,
    TaskSelected,
    pack_body,
    parse_body,
)

TASKS = ("aiming", "pursuit", "contour", "line", "spring", "free")


def steps(mission, run):
    return [one.step for one in mission.log if one.run == run]


def is_at_rest(mission):
    return (
        mission.robot.robot.mode == MODE_OFF
        and not mission.recording
        and mission.experiment.status.phase is Phase.IDLE
        # Nothing led the tip without the dead-man button.
        and mission.led_m < 1e-6
    )


def done(skill, tasks):
    """Do these tasks one after the other; by name: run, scores, and the panel's views."""
    mission, by_task = Mission(skill=skill), {}
    for number, name in enumerate(tasks, 1):
        mission.keeper, views = ScoreKeeper(), []

        def over(views=views, number=number):
            if mission.now_ns % LOOK_NS == MS:
                views.append(mission.panel.view)
            return len(mission.runs) == number

        assert mission.experiment.select(name, mission.now_ns) == ""
        assert mission.run(240, until=over), name
        mission.run(3)
        run = mission.runs[-1]
        assert (run.task, run.run, run.result) == (name, number, TaskResult.FINISHED), run.reason
        assert steps(mission, run.run) == list(RunStep)
        assert is_at_rest(mission)
        assert len(mission.records) == 2 * number
        by_task[name] = run, mission.keeper.report(), views
    assert mission.panel.mode is PanelMode.WAIT_TASK
    return by_task


@pytest.fixture(scope="module")
def trained():
    return done(1.0, TASKS)


def test_every_task_is_done_and_a_trained_cosmonaut_is_faster_and_nearer(trained):
    assert tuple(trained) == TASKS
    beginner = done(0.0, ("line", "spring"))
    (slow, slow_scores, _), (fast, fast_scores, _) = beginner["line"], trained["line"]
    assert fast_scores.error_mean < slow_scores.error_mean
    assert fast.ended_ns - fast.started_ns < slow.ended_ns - slow.started_ns


def test_the_panel_says_what_to_do_how_far_it_is_and_how_much_time_is_left(trained):
    by_task = {
        task: [view for view in views if view.left_s is not None and view.task == task]
        for task, (_, _, views) in trained.items()
    }
    waited = [one for one in by_task["aiming"] if one.goal == ""]
    assert 170.0 < waited[0].left_s <= 180.0 and waited[-1].left_s < waited[0].left_s
    aimed = [one for one in by_task["aiming"] if one.goal]
    lit = {(one.step, one.steps): one.target_m for one in aimed}
    expected = [LIGHTS_M[led] for led in (7, 0, 5, 0)]
    assert list(lit) == [(1, 4), (2, 4), (3, 4), (4, 4)]
    assert [*map(list, lit.values())] == [pytest.approx(place, abs=1e-6) for place in expected]
    # Each is held for half a second, which the panel counts.
    assert {one.hold_s for one in aimed} == {0.5} and max(one.held_s for one in aimed) > 0.3
    spots = [one.target_m for one in by_task["pursuit"] if one.goal == "eight"]
    assert len({*spots}) > 900 and all(abs(y_m) <= 0.024 for _, y_m in spots)
    percents = [one.percent for one in by_task["contour"] if one.goal == "contour"]
    assert percents == sorted(percents) and percents[-1] >= 80
    (force_n,) = {one.force_n for one in by_task["spring"] if one.goal == "spring"}
    assert force_n == 3.0


def reached(mission, phase, panel=None):
    status = mission.experiment.status
    return status.phase is phase and (panel is None or mission.panel.mode is panel)


MOMENTS = {
    "while the robot is prepared": (Phase.PREPARING, None),
    "while the panel describes it": (Phase.OFFERED, PanelMode.TASK_INFO),
    "while the handle is held": (Phase.OFFERED, PanelMode.HOLD),
    "in the task": (Phase.RUNNING, PanelMode.RUNNING),
}


@pytest.mark.parametrize("moment", MOMENTS)
@pytest.mark.parametrize("trouble", ["signal", "halt", "fault", "abort"])
def test_whatever_happens_ends_the_run_and_the_next_one_is_done(moment, trouble):
    phase, panel = MOMENTS[moment]
    mission = Mission()
    assert mission.experiment.select("aiming", mission.now_ns) == ""
    assert mission.run(60, until=lambda: reached(mission, phase, panel))
    if trouble == "signal":
        mission.signal = False
    elif trouble == "halt":
        mission.halted = "The joystick is too hot."
    elif trouble == "fault":
        mission.control.handle_fault("too hot")
    else:
        mission.experiment.abort("the experimenter", mission.now_ns)
    assert mission.run(12, until=lambda: mission.runs)
    (run,) = mission.runs
    expected = TaskResult.LOST_SIGNAL if trouble == "signal" else TaskResult.ABORTED
    assert run.result is expected, run
    # People are told why, at both ends.
    why = {"signal": "signal", "halt": "joystick", "fault": "too hot", "abort": "experimenter"}
    assert why[trouble] in run.reason
    logged = steps(mission, run.run)
    assert RunStep.CONDITION not in logged and RunStep.ENDED in logged
    assert (RunStep.FINISHED in logged) <= (trouble != "signal")
    assert is_at_rest(mission)
    mission.signal, mission.halted = True, ""
    mission.control.reset()
    mission.run(5)
    assert mission.panel.mode in (PanelMode.WAIT_TASK, PanelMode.ERROR)
    assert mission.do("aiming").result is TaskResult.FINISHED
    assert is_at_rest(mission)


def test_a_task_that_takes_too_long_times_out():
    mission = Mission()
    assert mission.experiment.select("aiming", 0) == ""
    assert mission.run(60, until=lambda: reached(mission, Phase.RUNNING))
    # The cosmonaut falls asleep, with the button pressed.
    mission.cosmonaut.look = lambda *_: None
    assert mission.run(80, until=lambda: mission.runs)
    assert (mission.runs[0].result, mission.runs[0].reason) == (
        TaskResult.TIMED_OUT,
        "checkPos7 was not done in 60 s",
    )
    mission.run(1)
    assert mission.panel.view.words == ("The task took too long. Step 1 of 4 was not done in time.")
    assert is_at_rest(mission)
    # One who never starts is not waited for for ever.
    mission = Mission(timeout_ns=8 * 10**9)
    mission.cosmonaut.look = lambda *_: None
    assert mission.experiment.select("line", 0) == ""
    assert mission.run(30, until=lambda: mission.runs)
    assert mission.runs[0].result is TaskResult.TIMED_OUT and mission.runs[0].started_ns is None
    mission.run(1)
    assert "Reason: the cosmonaut did not start." in mission.panel.view.words
    assert is_at_rest(mission)


def panel_of(run=1):
    """Return a panel in contact that was told of a run of the task `line`."""
    panel = MissionPanel()
    panel.handle_contact(True, 0)
    panel.handle_message(TaskSelected(task="line", run=run), 0)
    return panel


def test_who_keeps_the_dead_man_button_pressed_at_the_start_is_told_to_let_go():
    panel, words = panel_of(), []
    panel.handle_button(0)
    for second in range(8):
        dead_man = second != 6
        panel.handle_handle(0.0, 0.0, dead_man=dead_man, halted="", now_ns=second * 10**9)
        words.append(panel.view.words)
        if not dead_man:
            assert panel.mode is PanelMode.PRESS_DEADMAN and "Space" in panel.view.words
    assert "let go" not in words[2] and "let go" in words[5]
    assert panel.mode is PanelMode.RUNNING


def test_a_panel_shows_the_end_only_of_the_run_that_it_has():
    panel = panel_of(run=2)
    end = TaskFinished(task="line", run=2, result=TaskResult.FINISHED)
    panel.handle_message(replace(end, run=1), 1)
    assert panel.mode is PanelMode.TASK_INFO
    # What was told without contact is over.
    for contact, mode in ((False, PanelMode.NO_CONTACT), (True, PanelMode.WAIT_TASK)):
        panel.handle_contact(contact, 2)
        panel.handle_message(end, 3)
        assert panel.mode is mode
    panel.handle_message(TaskSelected(task="line", run=2), 4)
    panel.handle_message(end, 5)
    assert panel.mode is PanelMode.FINISHED


def test_any_reason_fits_in_the_messages_about_an_end():
    for reason in ("halted", "x" * 500, "two\nlines", "ü" * 100):
        panel = panel_of()
        panel.handle_handle(0.0, 0.0, dead_man=False, halted=reason, now_ns=1)
        told = list(iter(panel.poll_message, None))
        assert told[-1].mode is PanelMode.ERROR and told[-1].reason
        for message in told:
            assert parse_body(pack_body(Numbered(1, 0, 0, message))).message == message


def test_a_dead_man_button_that_is_let_go_stops_the_tip_and_not_the_task():
    mission = Mission()
    assert mission.experiment.select("pursuit", 0) == ""
    assert mission.run(60, until=lambda: reached(mission, Phase.RUNNING, PanelMode.RUNNING))
    mission.run(3)
    look = mission.cosmonaut.look
    mission.cosmonaut.look = lambda *_: None
    mission.cosmonaut.grip.let_go(0)
    mission.cosmonaut.handle_robot = lambda *_: None
    mission.run(0.5)
    mission.led_m = 0.0
    mission.run(2)
    # What was led before it was let go may still settle.
    assert mission.led_m < 1e-3
    mission.cosmonaut.look = look
    del mission.cosmonaut.handle_robot
    assert mission.run(60, until=lambda: mission.runs)
    assert mission.runs[0].result is TaskResult.FINISHED
