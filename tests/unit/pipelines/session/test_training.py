"""A trainer's requests become exercises with an end; what cannot be is refused in one line."""

import json

import pytest

from kontur_av.clock import NS_PER_S
from pipelines.session.figures import TrainerFigures
from pipelines.session.probe import Probe
from pipelines.session.terminal_lines import MOST_TERMINALS
from pipelines.session.training import Exercises, Trainer, TrainerReach

S = NS_PER_S


@pytest.fixture
def probe():
    return Probe()


@pytest.fixture
def trainer(probe):
    cameras = ("iss_camera", "head")
    reach = TrainerReach(radio=True, joystick=True, robot=True, tasks=True, cameras=cameras)
    return Trainer(probe, reach)


def ask(trainer, now_ns=0, **request):
    """The answer to a request of a new terminal."""
    trainer.desk.handle_terminal(1)
    trainer.desk.handle_octets(1, json.dumps(request).encode() + b"\n", now_ns)
    reply = trainer.desk.next_event()
    assert reply.last
    assert trainer.desk.next_event() is None
    return json.loads(reply.octets) if reply.octets else None


def test_each_exercise_lasts_until_its_own_end_and_all_can_be_ended(trainer, probe):
    assert ask(trainer, 5 * S, exercise="los", seconds=20)["text"] == "no signal for 20 s"
    assert ask(trainer, 6 * S, exercise="joystick-error", seconds=2.5)["ok"]
    assert ask(trainer, 6 * S, exercise="robot-fault", seconds=4)["text"] == "robot fault for 4 s"
    assert ask(trainer, 6 * S, exercise="task-failed", seconds=1)["text"] == "tasks fail for 1 s"
    for camera in ("head", "iss_camera"):
        assert ask(trainer, 7 * S, exercise="camera-lost", seconds=3, camera=camera)["ok"]
    exercises = Exercises.unpack(trainer.exercises.pack())
    assert exercises == Exercises(
        los_ns=25 * S,
        joystick_ns=round(8.5 * S),
        robot_ns=10 * S,
        tasks_ns=7 * S,
        cameras_ns={"head": 10 * S, "iss_camera": 10 * S},
    )
    assert ask(trainer, 9 * S, exercise="end")["ok"]
    assert trainer.exercises == Exercises()
    trainer.tell()
    gauges = probe.message.figures[TrainerFigures, ""]
    assert [event.at_ns // S for event in gauges.exercises] == [5, 6, 6, 6, 7, 7, 9]


@pytest.mark.parametrize(
    ("request_", "says"),
    [
        ({"exercise": "fire", "seconds": 1}, "no exercise fire: take los, joystick-error"),
        ({"exercise": "los", "seconds": 0}, "0 s: take more than 0"),
        ({"exercise": "los", "seconds": -1}, "-1 s: take more than 0"),
        ({"exercise": "los", "seconds": 1e9}, "at most 3600"),
        ({"exercise": "camera-lost", "seconds": 1, "camera": "left"}, "here are iss_camera, head"),
    ],
)
def test_what_cannot_be_is_refused_and_changes_nothing(trainer, request_, says):
    before = trainer.exercises
    answer = ask(trainer, **request_)
    assert says in answer["text"]
    assert answer["mistake"]
    assert not answer["ok"]
    assert trainer.exercises is before


def test_what_is_at_the_other_end_is_asked_for_there(probe):
    reach = TrainerReach(radio=False, joystick=False, robot=False, cameras=("head",))
    ground = Trainer(probe, reach)
    assert "at the ground's end" in ask(ground, exercise="task-failed", seconds=1)["text"]
    for exercise in ("los", "joystick-error", "robot-fault"):
        assert "ask there" in ask(ground, exercise=exercise, seconds=1)["text"]
    assert ask(ground, exercise="camera-lost", seconds=1, camera="head")["ok"]


def test_what_lasts_is_published_again_for_a_process_that_began_since(trainer):
    trainer.poll_exercises(0)
    ask(trainer, exercise="robot-fault", seconds=20)
    told = trainer.poll_exercises(1)
    assert told.robot_ns > 0
    asked_ns = range(1, 3 * NS_PER_S, NS_PER_S // 10)
    again = [now_ns for now_ns in asked_ns if trainer.poll_exercises(now_ns) == told]
    assert again == [1 + NS_PER_S, 1 + 2 * NS_PER_S]


@pytest.mark.parametrize("line", [b"\n", b"[[[[\n", b'{"exercise": 7}\n', b"x" * 9000, b""])
def test_garbage_closes_the_connection(trainer, line):
    trainer.desk.handle_terminal(1)
    trainer.desk.handle_octets(1, line, 0)
    assert trainer.desk.next_event() == (1, b"", True)
    assert trainer.desk.asking == []
    for terminal in range(MOST_TERMINALS):
        trainer.desk.handle_terminal(terminal)
    trainer.desk.handle_terminal(99)
    assert trainer.desk.next_event() == (99, b"", True)
