"""Trials of `benchmarks haptics`: drawn, run, judged from outside, and written as traces."""

import json
from dataclasses import replace

import numpy as np
import pytest
from mcap.reader import make_reader

from benchmarks.__main__ import main
from benchmarks.haptics.claims import trial_claims
from benchmarks.haptics.hands import TRIAL_HANDS, TrialHand
from benchmarks.haptics.traces import TRACES
from benchmarks.haptics.trial import BAND_NAMES, MODES, Trial, plan_trial, random_trials
from benchmarks.haptics.trial_command import read_trial
from benchmarks.haptics.trial_figures import summaries, trial_figures
from benchmarks.haptics.trial_run import COLUMNS, TurnedBoard, run_trial
from telepresence.haptics.board import Board, WallModel

MS = 1_000_000
ACTIVE = """
from telepresence.haptics.joystick_controller import JoystickController
from telepresence.haptics.robot_controller import RobotController

class Joystick(JoystickController):
    def __init__(self):
        super().__init__(passive=False)

class Robot(RobotController):
    def __init__(self, *, x_m, y_m):
        super().__init__(passive=False, x_m=x_m, y_m=y_m)
"""


def tried(trial, **options):
    planned, course = run_trial(trial, seed=1, **options)
    return trial_figures(trial, planned, course), course


def test_trials_follow_from_the_seed_and_meet_every_value():
    trials = list(random_trials(300, seed=3, modes=MODES))
    assert trials == list(random_trials(300, seed=3, modes=MODES))
    assert trials != list(random_trials(300, seed=4, modes=MODES))
    assert all(read_trial(trial.name) == trial for trial in trials)
    assert len({trial.setting for trial in trials}) == 300
    for name, values in (*Trial.words.items(), ("band", BAND_NAMES[:-1])):
        found = {getattr(trial, name) for trial in trials}
        assert found == ({"off"} if name == "envelope" else set(values))
    angles = [trial.angle for trial in trials]
    assert min(angles) < -150 < 150 < max(angles)


@pytest.mark.parametrize("angle", [0.0, 30.0, -90.0, 180.0])
def test_a_turned_wall_pushes_as_a_straight_one_does(angle):
    trial, model = Trial(angle=angle), WallModel()
    board, straight = TurnedBoard(model, trial.normal), Board(spring=None, contour=None)
    (nx, ny), (ahead, across), (fast, aside) = trial.normal, (0.07, 0.02), (0.1, -0.05)

    def turned(a, b):
        return a * nx - b * ny, a * ny + b * nx

    expected = turned(*straight.press(ahead, across, fast, aside))
    found = board.press(*turned(ahead, across), *turned(fast, aside))
    assert found == pytest.approx(expected) and board.touching
    assert board.press(*turned(0.05, across), 0.0, 0.0) == (0.0, 0.0)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("restart", ["joystick", "robot", "both"])
def test_a_restart_in_contact_keeps_the_plants_and_the_claims(mode, restart):
    trial = Trial(delay=40.0, angle=-120.0, place=40.0, hand="firm", restart=restart, mode=mode)
    found, course = tried(trial)
    lives = course["joystick_lives"].max(), course["robot_lives"].max()
    assert lives == (1 + (restart != "robot"), 1 + (restart != "joystick"))
    for name in ("handle_x", "handle_y", "tip_x", "tip_y"):
        assert np.abs(np.diff(course[name])).max() < 1e-3
    assert 50.0 < found.felt_first < 110.0
    assert 50.0 < found.felt_last < 110.0
    assert found.felt_restart is not None
    for claim in trial_claims([found]):
        assert claim.holds, f"{claim.text}: {claim.found}"


def test_an_envelope_asks_for_a_press_after_a_restart():
    trial = Trial(delay=40.0, restart="robot", envelope="on")
    planned, course = run_trial(trial, seed=1)
    assert len(course) > planned.end_ns // MS + 500
    assert trial_figures(trial, planned, course).felt_last > 90.0


def test_a_controller_that_makes_energy_breaks_the_claims(tmp_path, monkeypatch, capsys):
    (tmp_path / "active.py").write_text(ACTIVE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    own = ["--controller", "active:Joystick", "--robot-controller", "active:Robot"]
    trial = ["haptics", "--trial", "delay=100,hand=firm", "--jobs", "1"]
    assert main([*trial, "--report", "a.json"]) == 0
    assert main([*trial, *own, "--report", "b.json"]) == 1
    good, bad = (json.loads((tmp_path / name).read_text()) for name in ("a.json", "b.json"))
    assert all(claim["holds"] for claim in good["claims"])
    assert not any(claim["holds"] for claim in bad["claims"] if "energy" in claim["text"])
    assert bad["trials"][0]["network_uj"] > 1000.0
    assert "NO" in capsys.readouterr().out


def test_a_hand_that_lets_go_leaves_the_handle_and_takes_it_where_it_is():
    bench = TRIAL_HANDS["lets-go"]
    planned = plan_trial(Trial(hand="lets-go"), 1)
    hand = TrialHand(bench, planned.script, leaves=planned.leaves, seed="1")
    while hand.place < planned.leaves:
        hand.force(0.08, 0.0, 0.0, 0.0, MS)
    assert hand.force(0.02, 0.01, 0.0, 0.0, MS) == (0.0, 0.0)
    assert hand.mass_kg == 0.0 and not hand.dead_man
    while hand.place[0] == planned.leaves[0]:
        hand.force(0.02, 0.01, 0.0, 0.0, MS)
    for _ in range(5):
        fx, fy = hand.force(0.02, 0.01, 0.0, 0.0, MS)
    assert hand.dead_man and abs(fx) < 1.0 and abs(fy) < 1.0


def test_the_summary_names_the_worst_trial():
    found = [tried(Trial(delay=delay, wall=500.0))[0] for delay in (10.0, 40.0)]
    worse = replace(found[1], drift_mm=9.0, felt_first=5.0)
    over = {(s.group, s.figure): s for s in summaries([found[0], worse])}
    assert over["0-60 ms", "drift_mm"].worst_trial == worse.trial.name
    assert over["soft", "felt_first"].worst == 5.0
    assert over["all", "felt_first"].median == pytest.approx((5.0 + found[0].felt_first) / 2)
    assert over["all", "felt_restart"].trials == 0


def test_a_trace_is_read_back_with_units_and_bears_its_figures(tmp_path):
    text = "delay=30,loss=5,wall=500,angle=90"
    assert main(["haptics", "--trial", text, "--traces", str(tmp_path), "--jobs", "1"]) == 0
    (path,) = tmp_path.glob("*.mcap")
    found, course = tried(read_trial(text))
    with path.open("rb") as file:
        reader = make_reader(file)
        (schema,) = reader.get_summary().schemas.values()
        about = {record.name: record.metadata for record in reader.iter_metadata()}
        read = [(m.log_time, json.loads(m.data)) for _, _, m in reader.iter_messages()]
    units = {name: value["unit"] for name, value in json.loads(schema.data)["properties"].items()}
    assert units == {name: unit for name, (unit, _) in COLUMNS.items()}
    assert [at for at, _ in read] == [row * MS for row in range(len(course))]
    for name in COLUMNS:
        assert np.allclose([row[name] for _, row in read], course[name], rtol=1e-6, atol=1e-9)
    assert about["trial"]["wall"] == "500.0" and about["trial"]["seed"] == "1"
    assert float(about["figures"]["felt_first"]) == found.felt_first
    assert read[-1][1]["commands_lost"] > 100 and read[-1][1]["command_delay"] == 15.0


def test_the_public_traces_are_twenty_with_every_hand():
    trials = [read_trial(text) for text in TRACES]
    assert len({trial.name for trial in trials}) == 20
    assert [trial.name for trial in trials] == list(TRACES)
    assert {trial.hand for trial in trials} == set(TRIAL_HANDS)
