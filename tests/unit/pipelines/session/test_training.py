"""A trainer's requests become exercises with an end; what cannot be is refused in one line."""

import pytest

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ConfigError
from pipelines.session.probe import Probe
from pipelines.session.session_metrics import TrainerMetrics
from pipelines.session.setup.segments import Segment
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.session.training import (
    END,
    EXERCISES,
    Exercises,
    Trainer,
    TrainerReach,
    TrainerRequest,
)
from pipelines.table import topology_of
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary

S = NS_PER_S


def trainer_of(probe=None, *, here=True, cameras=("operator_camera", "head")):
    reach = TrainerReach(radio=here, joystick=here, robot=here, tasks=here, cameras=cameras)
    return Trainer(probe or Probe(), reach)


def ask(trainer, exercise, seconds=1, now_ns=0, **more):
    """The answer to a request."""
    request = TrainerRequest(exercise=exercise, seconds=seconds, **more)
    return trainer.handle_request(request, now_ns).text


def test_each_exercise_lasts_until_its_own_end_and_all_can_be_ended():
    probe = Probe()
    trainer = trainer_of(probe)
    assert ask(trainer, "los", 20, 5 * S) == "no signal for 20 s"
    ask(trainer, "joystick-error", 2.5, 6 * S)
    assert ask(trainer, "robot-fault", 4, 6 * S) == "robot fault for 4 s"
    assert ask(trainer, "task-failed", 1, 6 * S) == "tasks fail for 1 s"
    for camera in ("head", "operator_camera"):
        ask(trainer, "camera-lost", 3, 7 * S, camera=camera)
    assert trainer.exercises == Exercises(
        los_ns=25 * S,
        joystick_ns=round(8.5 * S),
        robot_ns=10 * S,
        tasks_ns=7 * S,
        cameras_ns={"head": 10 * S, "operator_camera": 10 * S},
    )
    ask(trainer, "end", now_ns=9 * S)
    assert trainer.exercises == Exercises()
    trainer.publish()
    gauges = probe.message.metrics[TrainerMetrics, ""]
    assert [event.at_ns // S for event in gauges.exercises] == [5, 6, 6, 6, 7, 7, 9]


@pytest.mark.parametrize(
    ("request_", "says"),
    [
        ({"exercise": "fire"}, "no exercise fire: take los, joystick-error"),
        ({"exercise": "los", "seconds": 0}, "0 s: take more than 0"),
        ({"exercise": "los", "seconds": -1}, "-1 s: take more than 0"),
        ({"exercise": "los", "seconds": 1e9}, "at most 3600"),
        ({"exercise": "camera-lost", "camera": "left"}, "here are operator_camera, head"),
    ],
)
def test_what_cannot_be_is_refused_and_changes_nothing(request_, says):
    trainer = trainer_of()
    before = trainer.exercises
    with pytest.raises(ConfigError, match=says):
        ask(trainer, **request_)
    assert trainer.exercises is before


def test_what_is_at_the_other_end_is_asked_for_there_and_what_lasts_is_published_again():
    ground = trainer_of(here=False, cameras=("head",))
    with pytest.raises(ConfigError, match="at the ground's end"):
        ask(ground, "task-failed")
    for exercise in ("los", "joystick-error", "robot-fault"):
        with pytest.raises(ConfigError, match="ask there"):
            ask(ground, exercise)
    assert ask(ground, "camera-lost", camera="head")
    trainer = trainer_of()
    trainer.poll_exercises(0)
    ask(trainer, "robot-fault", 20)
    told = trainer.poll_exercises(1)
    assert told.robot_ns > 0
    asked_ns = range(1, 3 * S, S // 10)
    again = [now_ns for now_ns in asked_ns if trainer.poll_exercises(now_ns) == told]
    assert again == [1 + S, 1 + 2 * S]


def test_a_trainer_in_space_alone_gives_all_faults_and_asks_the_ground_for_those_there():
    topology = topology_of(BUILT_IN["taskboard"], segments=(Segment.SPACE,), trainer=True)
    trainer = Trainer(Probe(), TrainerReach.of(topology))
    for exercise in ("los", "joystick-error", "robot-fault", "task-failed", "end"):
        ask(trainer, exercise, 5)
    assert trainer.exercises == Exercises()
    table = built_in_dictionary().application("trainer")
    asked = [*iter(trainer.next_asked, None)]
    assert asked == [("robot_fault", (5,)), ("task_failed", (5,)), ("end", ())]
    for name, arguments in asked:
        # What the ground is asked for is in its dictionary.
        assert len(table.function(name).arguments) == len(arguments)
        assert name.replace("_", "-") in (*EXERCISES, END)
