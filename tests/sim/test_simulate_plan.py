"""`kontur-av simulate --plan`: tasks over the simulated link, by PUS, with rows in the report."""

import pytest

from kontur_av.errors import ConfigError
from pipelines.cli import main
from pipelines.report.model import SessionReport, from_json, to_json
from pipelines.session.setup.setup_file import load_setup
from pipelines.session.task_journal import STEPS
from pipelines.virtual.simulate import simulate
from telepresence.tasks.plan import PlanFollower, TaskWorld
from telepresence.tasks.task_files import load_plan

PLAN = '[[task]]\nname = "aiming"\n[[task]]\nname = "line"\n'


def plan_of(tmp_path, text):
    path = tmp_path / "plan.toml"
    path.write_text(text)
    return load_plan(path)


def test_the_tasks_of_a_plan_are_done_over_the_link(tmp_path):
    plan = plan_of(tmp_path, PLAN)
    runs = [
        simulate(load_setup("taskboard"), seconds=36, seed=1, media=False, plan=plan)
        for _ in range(2)
    ]
    report, again = runs
    assert report.failures == []
    assert [(run.name, run.run, run.result) for run in report.tasks] == [
        ("aiming", 1, "finished"),
        ("line", 2, "finished"),
    ]
    for run in report.tasks:
        assert [step.step for step in run.steps] == list(STEPS)
        assert run.seconds > 0 and run.path_m > 0.05 and run.frames_lost == 0
    assert to_json(again) == to_json(report)


def test_an_unattended_session_by_the_command(tmp_path):
    (tmp_path / "plan.toml").write_text('skill = 1.0\n[[task]]\nname = "aiming"\n')
    words = ["simulate", "--setup", "taskboard", "--seconds", "12", "--no-media", "-q"]
    words += ["--plan", str(tmp_path / "plan.toml"), "--report", str(tmp_path / "r.json")]
    assert main(words) == 0
    report = from_json((tmp_path / "r.json").read_text(), SessionReport)
    # Still under way at its end.
    (run,) = report.tasks
    assert (run.name, run.result, run.seconds) == ("aiming", "open", None)
    assert len(run.steps) > 2


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", r"at least one \[\[task\]\]"),
        ('[[task]]\nname = "dancing"\n', "unknown task dancing: choose one of aiming"),
        ('[[task]]\nname = "aiming"\nrepeat = 0\n', "repeat is 0: give 1 to 1000"),
        ('skill = 3\n[[task]]\nname = "line"\n', "skill is 3: give 0"),
        ('[[task]]\nnome = "line"\n', "nome"),
        ('files = ["none.xml"]\n[[task]]\nname = "line"\n', "cannot read tasks"),
        ("[[task]\n", "not TOML"),
    ],
)
def test_mistakes_in_a_plan_are_named(tmp_path, text, words):
    with pytest.raises(ConfigError, match=words):
        plan_of(tmp_path, text)


def test_a_camera_that_a_task_needs_and_the_setup_lacks_is_named(tmp_path):
    plan, catalogue = plan_of(tmp_path, PLAN)
    with pytest.raises(ConfigError, match="task aiming selects the camera stereo"):
        plan.check(catalogue, TaskWorld(cameras=("head",), setup="lab"))


def test_a_task_is_selected_once_contact_and_robot_have_been_free_for_a_while(tmp_path):
    plan, _ = plan_of(tmp_path, f"again = true\n{PLAN}")
    follower = PlanFollower(plan)
    chosen, idle, free_s = [], True, 0
    for tick in range(400):
        now_ns = tick * 10**8
        # No signal for the first 2 s; each task takes 5 s.
        signal = tick >= 20
        if not idle and tick >= free_s:
            idle = True
            # The second run is lost.
            if len(chosen) != 2:
                follower.handle_finished()
        name = follower.poll_select(idle=idle, signal=signal, now_ns=now_ns)
        if name is not None:
            chosen.append((tick, name))
            idle, free_s = False, tick + 50
    assert chosen[:3] == [(50, "aiming"), (130, "line"), (210, "line")]
    assert chosen[3] == (290, "aiming")
