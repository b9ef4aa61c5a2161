"""Plans of studies: every order equally often, and what cannot work is refused."""

from collections import Counter
from itertools import pairwise

import pytest

from kontur_av.errors import ConfigError
from pipelines.study.plan import Aiming, HandleLevels, StudyPlan, Tracking, latin_square, trials_of
from pipelines.study.running import load_study

FOUR = {"damping_n_s_m": (0.0, 10.0), "inertia_kg": (0.0, 1.0)}


def plan_of(**changes):
    handle = HandleLevels(**changes.pop("levels", FOUR))
    given = {"name": "x", "consent": "Yes.", "participants": 4, "aiming": (Aiming(name="still"),)}
    return StudyPlan(handle=handle, **(given | changes))


def test_each_condition_stands_equally_often_at_each_place_and_participants_meet_every_handle():
    for count in range(2, 17):
        square, twice = latin_square(count), count % 2 + 1
        places = Counter((place, one) for row in square for place, one in enumerate(row))
        assert set(places.values()) == {twice} and len(places) == count * count
        follow = Counter(pair for row in square for pair in pairwise(row))
        assert set(follow.values()) == {twice} and len(follow) == count * (count - 1)
    plan = plan_of(tracking=(Tracking(name="spot"),), participants=8, practice=1, trials=2)
    seen = Counter()
    for participant in range(1, 9):
        trials = trials_of(plan, participant)
        assert len(trials) == plan.trials_each == 4 * 2 * 3
        assert [trial.opens for trial in trials] == [True, False, False] * 8
        assert {trial.condition for trial in trials} == {*plan.handle.conditions}
        seen.update({(trial.place, trial.condition) for trial in trials})
    assert set(seen.values()) == {2} and len(seen) == 16
    assert trials_of(plan, 3) == trials_of(plan, 3)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"participants": 6}, "participants is 6: 4 handles have 4 orders, so take 4, 8, 12"),
        ({"consent": " "}, 'consent is "": write what a participant agrees to'),
        ({"aiming": ()}, "write [[aiming]] or [[tracking]]"),
        ({"trials": 0}, "trials is 0: give 1 to 50"),
        ({"levels": {"stiffness_n_m": (0.0, 300.0)}}, "a hand at the page pulls 6: take 120"),
        ({"levels": {"damping_n_s_m": (0.0, 90.0)}}, "handle.damping_n_s_m is 90: give 0 to 60"),
        ({"levels": {"inertia_kg": (1.0, 1.0)}}, "handle.inertia_kg is [1.0, 1.0]: give different"),
        ({"levels": {}}, "handle has 1 combinations of levels: give 2 to 16"),
    ],
)
def test_what_cannot_work_is_refused_with_value_and_mend(changes, words):
    with pytest.raises(ConfigError) as refused:
        plan_of(**changes)
    assert words in str(refused.value)


def test_a_file_is_refused_by_its_name(tmp_path):
    path = tmp_path / "plan.toml"
    path.write_text('name = "x"\nconsent = "Yes."\nparticipants = 4\nnotes = ""\n[handle]\n')
    with pytest.raises(ConfigError, match=r"plan.toml: unknown field notes: the nearest .* note"):
        load_study(path)
    path.write_text('name = "x"\nconsent = "Yes."\nparticipants = 2\n[handle]\ninertia_kg = 1\n')
    with pytest.raises(ConfigError, match=r"handle.inertia_kg must be"):
        load_study(path)
