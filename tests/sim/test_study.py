"""Simulated hands go through a whole study: what changes their hands is found, and only that."""

import pytest

from pipelines.cli import main
from pipelines.study.effects import study_report
from pipelines.study.plan import Aiming, HandleLevels, StudyPlan, Tracking
from pipelines.study.trials import simulate_person

pytest.importorskip("scipy")

#: A damper that the hand feels, and a spring that nobody can.
PLAN = StudyPlan(
    name="x",
    consent="Yes.",
    participants=8,
    handle=HandleLevels(stiffness_n_m=(0.0, 0.001), damping_n_s_m=(0.0, 50.0)),
    aiming=(Aiming(name="still", targets=5),),
    tracking=(Tracking(name="spot", seconds=3.0),),
    practice=0,
    trials=1,
    break_s=600.0,
)


def report_of(seed, plan=PLAN):
    people = range(1, plan.participants + 1)
    results = [one for person in people for one in simulate_person(plan, person, seed)]
    return results, study_report(plan, results)


def test_the_effect_is_found_the_null_is_not_and_the_same_seed_gives_the_same():
    results, report = report_of(1)
    assert len(report.participants) == 8 and report.voids == 0
    found = {(one.task, one.measure, one.factor) for one in report.effects if one.differs}
    assert ("still", "time of a movement", "damping") in found
    assert ("spot", "error, root mean square", "damping") in found
    assert {factor for _, _, factor in found} == {"damping"}
    assert [*simulate_person(PLAN, 3, 1)] == [one for one in results if one.participant == 3]


def test_the_command_simulates_people_keeps_their_trials_and_shows_the_effects(tmp_path, capsys):
    plan, results = tmp_path / "plan.toml", tmp_path / "trials"
    plan.write_text(
        'name = "x"\nconsent = "Yes."\nparticipants = 2\npractice = 0\ntrials = 1\n'
        "[handle]\nstiffness_n_m = [0.0]\ndamping_n_s_m = [0.0, 50.0]\n"
        '[[aiming]]\nname = "still"\ntargets = 5\n'
    )
    words = ["study", str(plan), "--simulated", "2", "--seed", "1", "--results", str(results)]
    assert main(words) == 0
    shown = capsys.readouterr().out
    assert "2 participants have finished" in shown
    kept = {path.name: path.read_bytes() for path in results.iterdir()}
    assert {"trials.jsonl", "report.html", "study.mat"} <= set(kept)
    # Trials of simulated hands are never taken for those of people.
    assert main(["study", str(plan), "--report", "--results", str(results)]) == 2
    assert "simulated hands" in capsys.readouterr().err
    assert (results / "trials.jsonl").read_bytes() == kept["trials.jsonl"]
