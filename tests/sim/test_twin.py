"""What a session on virtual time does as a live one, beside the media themselves."""

import pytest
from tmtc_session import Session

from kontur_av.clock import NS_PER_S
from pipelines.media.media_metrics import CodingCosts
from pipelines.mission.tmtc_messages import CommandUpdate, Reported
from pipelines.session.mission_messages import RobotStatus
from pipelines.session.setup.segments import Segment
from pipelines.session.setup.setup_file import load_setup
from pipelines.virtual.session import Simulation
from pipelines.virtual.workers import Workers
from telepresence.haptics.envelope import Hold
from telepresence.tasks.task_files import load_plan


@pytest.mark.rule("S5")
def test_a_picture_that_is_always_too_old_holds_the_robot():
    costs = CodingCosts(capture_ms=999, decode_ms=999)
    with Workers() as workers:
        simulation = Simulation(load_setup("spacejustin"), workers, seed=1, costs=costs)
        simulation.run(5 * NS_PER_S)
        assert simulation.report().safety.hold is Hold.PICTURE


def test_telecommands_for_processes_are_answered_and_telemetry_has_them():
    session = Session(answers=False)
    session.run(2.5)
    for number, (verb, more) in enumerate(
        (
            ("call", {"name": "start", "arguments": ("ground_display",)}),
            ("call", {"name": "stop", "arguments": ("uplink_video_send",)}),
            ("parameters", {"arguments": ("robot_state",)}),
        )
    ):
        session.command(Segment.SPACE, number, "ground_supervisor", verb, **more)
    session.run(3)
    done = {one.id: one for one in session.of(Segment.SPACE, CommandUpdate) if one.done}
    assert [done[number].ok for number in range(3)] == [True, False, True]
    assert "a simulation stops no process" in done[1].reason
    (told,) = [one for one in session.of(Segment.SPACE, Reported) if one.kind == "parameters"]
    assert told.values == {"robot_state": "running"}


def test_robot_and_joystick_publish_20_states_a_second_and_obey_within_10_ms():
    session = Session(answers=False)
    told, tmtc, commands = [], session.tmtc, session.simulation.robot_commands
    take = tmtc.handle_status
    tmtc.handle_status = lambda status: (told.append(status), take(status))
    session.run(2)
    assert 38 <= sum(isinstance(each, RobotStatus) for each in told) <= 42
    session.command(Segment.SPACE, 1, "robot", "call", "power_off")
    while not tmtc.robot_commands and session.now_ns < 4 * NS_PER_S:
        session.run(0.001)
    assert commands.control.powered
    session.run(0.01)
    assert not commands.control.powered


def test_tasks_and_panel_answer_telecommands_and_have_parameters(tmp_path):
    (tmp_path / "plan.toml").write_text('[[task]]\nname = "aiming"\n')
    plan = load_plan(tmp_path / "plan.toml")
    with Workers() as workers:
        simulation = Simulation(load_setup("spacejustin"), workers, seed=1, media=False, plan=plan)
        tmtc, news = simulation.tmtc, []
        tmtc.subscribe(Segment.GROUND, lambda one, _: news.append(one))
        tmtc.subscribe(Segment.SPACE, lambda one, _: news.append(one))
        simulation.run(NS_PER_S)
        session = Session.__new__(Session)
        session.tmtc, session.now_ns = tmtc, NS_PER_S
        session.command(Segment.SPACE, 1, "tasks", "call", "abort")
        session.command(Segment.GROUND, 2, "panel", "parameters", arguments=("mode",))
        session.command(Segment.GROUND, 3, "panel", "call", "button")
        simulation.run(4 * NS_PER_S)
    done = {one.id: one for one in news if isinstance(one, CommandUpdate) and one.done}
    assert sorted(done) == [1, 2, 3]
    assert "nobody" not in done[1].reason and done[2].ok and done[3].ok
