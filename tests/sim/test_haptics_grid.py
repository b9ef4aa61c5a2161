"""Cells of `benchmarks haptics`: passive, calm and bounded, or not, at whatever hand."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.haptics.cell import MODES, Cell, read_cell
from benchmarks.haptics.claims import claims, needed
from benchmarks.haptics.hands import HANDS, BenchHand
from benchmarks.haptics.haptics_metrics import CellMetrics, metrics, vectors
from benchmarks.haptics.run import run_cell
from telepresence.haptics.hand import HandModel
from telepresence.haptics.joystick_controller import JoystickController
from telepresence.haptics.sample import Feedback

MS = 1_000_000


def ran(cell: Cell, seed: int = 1) -> CellMetrics:
    return metrics(cell, *run_cell(cell, seed=seed))


def check(found: CellMetrics) -> None:
    for claim in claims([found]):
        assert claim.holds, f"{claim.text}: {claim.found}"


@pytest.mark.parametrize(
    "cell",
    [
        Cell(),
        Cell(delay=500.0, wall=500.0, damping=150.0, friction=0.4),
        Cell(jitter=50.0, copies=30.0),
        Cell(delay=100.0, jitter=50.0, loss=30.0, burst=10.0, blackout=1.0),
        Cell(delay=1000.0, jitter=50.0, loss=30.0),
    ],
    ids=lambda cell: cell.name,
)
def test_every_claim_holds_and_the_wall_is_met_and_felt(cell) -> None:
    """A hard wall under the worst conditions of the radio."""
    found = ran(cell)
    check(found)
    # A controller that does nothing would be passive too.
    assert found.touches >= 2 and found.displayed_peak_n > 3.0


@pytest.mark.parametrize(
    "cell",
    [Cell(delay=100.0), Cell(delay=50.0, loss=30.0, wall=1500.0)],
    ids=lambda cell: cell.name,
)
def test_without_the_controllers_the_same_cell_makes_energy_and_swings(cell) -> None:
    found = ran(replace(cell, passive="off"))
    assert found.unstable
    assert needed([found]).holds
    assert found.least_uj < -100_000


@pytest.mark.parametrize("wall", [1500.0, 5000.0])
def test_a_blackout_brings_both_ends_to_rest_and_resumption_no_jump(wall) -> None:
    planned, course = run_cell(Cell(delay=20.0, blackout=5.0, wall=wall), seed=1)
    tip, displayed, wall_n = vectors(course, "tip"), vectors(course, "motor"), -course["wall_x"]
    down, up = (
        [(b // MS, e // MS) for b, e in dark] for dark in (planned.down_dark, planned.up_dark)
    )
    for begin, end in down:
        # The robot receives nothing, so it stops pressing and stands still.
        assert wall_n[end - 100 : end].max() < 0.1
        assert np.ptp(tip[end - 100 : end], axis=0).max() < 1e-4
        assert wall_n[begin] > 1.0
    for _, end in up:
        # The joystick receives nothing, so it displays only its own damping.
        assert np.abs(displayed[end - 100 : end]).max() < 1.0
    for _, end in {*down, *up}:
        back = slice(end - 1, end + 500)
        assert np.diff(np.hypot(*displayed[back].T)).max() < 1.1
        assert np.abs(np.diff(tip[back], axis=0)).max() < 0.6e-3


@pytest.mark.parametrize(
    ("seed", "text"),
    [
        # Bursts of losses on a still hand.
        (608, "delay=96,loss=3,burst=13,wall=1600,place=64,free=3,at=free,mode=deadband"),
        # The hand leaves the wall so fast that credit for the way back is scarce.
        (602, "delay=332,loss=19,burst=20,blackout=2,wall=180,angle=180,place=50,hand=lets-go"),
        # Samples of before the restart, still on their way, and out of order.
        (607, "delay=48,jitter=46,wall=70,angle=90,place=19,hand=arm-1kg,restart=both"),
    ],
)
def test_forces_are_calm_and_the_tip_catches_up(seed, text) -> None:
    found = ran(read_cell(text), seed)
    assert found.drift_mm < 2.0 and found.swing_n < 2.0
    check(found)


@pytest.mark.parametrize(
    ("stiffness", "damping", "mass", "cell"),
    [
        (500.0, 35.0, 1.5, Cell(delay=50.0, wall=5000.0)),
        (800.0, 24.0, 2.0, Cell(delay=50.0, wall=5000.0)),
        (700.0, 35.0, 0.4, Cell(delay=20.0, wall=5000.0, loss=30.0, burst=10.0)),
    ],
)
def test_no_force_swings_on_at_any_hand(stiffness, damping, mass, cell, monkeypatch) -> None:
    """A controller that switched its force off and slowly on again swung by 2 to 3 N for ever."""
    model = HandModel(stiffness_n_m=stiffness, damping_n_s_m=damping, mass_kg=mass)
    monkeypatch.setitem(HANDS, "soft", BenchHand(model=model))  # type: ignore[arg-type]
    check(ran(cell))


def test_a_cut_force_returns_slowly() -> None:
    """A fast return would be cut again at once, a hundred times a second, and buzz."""
    joystick_side = JoystickController()
    wall, x_m = Feedback(-8.0, 0.0, 0, True), 0.05
    forces = []
    for step in range(400):
        # The hand moves along with a force that nobody paid for; then it rests.
        x_m -= 3e-4 if step < 100 else 0.0
        joystick_side.step(wall, x_m, 0.0, MS)
        forces.append(joystick_side.robot_force_n[0])
        if step == 100:
            joystick_side.port.handle_total(0, MS)
            joystick_side.port.handle_total(20_000, MS)
    assert joystick_side.acted > 50
    assert min(np.diff(forces[101:])) > -0.2
    assert forces[-1] < forces[150] - 2.0


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("restart", ["joystick", "robot", "both"])
def test_a_restart_in_contact_keeps_the_plants_and_the_claims(mode, restart) -> None:
    cell = Cell(
        delay=40.0, wall=1500.0, angle=-120.0, place=40.0, hand="firm", restart=restart, mode=mode
    )
    planned, course = run_cell(cell, seed=1)
    lives = course["joystick_lives"].max(), course["robot_lives"].max()
    assert lives == (1 + (restart != "robot"), 1 + (restart != "joystick"))
    for name in ("handle_x", "handle_y", "tip_x", "tip_y"):
        assert np.abs(np.diff(course[name])).max() < 1e-3
    found = metrics(cell, planned, course)
    assert 50.0 < found.felt_first < 110.0 and 50.0 < found.felt_last < 110.0
    assert found.felt_restart is not None
    check(found)


@pytest.mark.parametrize(
    ("felt", "least", "seed", "text"),
    [
        ("last", 60, 1, "delay=300,wall=1500,hand=firm"),
        # The robot has no credit to move, and a tip that rests reveals no wall.
        (
            *("restart", 95, 1),
            "delay=104,wall=98,angle=-48,place=59,hand=loose,restart=both,mode=auto",
        ),
        # A wall that is late after a restart comes back faster.
        (
            *("restart", 80, 805),
            "delay=527,wall=1700,hand=tremor,restart=joystick,mode=auto,angle=-90,place=47,free=3",
        ),
        # A soft wall, met aslant, was taken for a steep one at 50 degrees to it.
        ("last", 80, 829, "delay=44,loss=18,burst=16,wall=87,place=22,hand=arm-1kg,mode=auto"),
        # A push brings little energy along, so none may be lost on the way back.
        ("first", 50, 1, "delay=275,wall=1900,place=21,hand=push,mode=auto"),
    ],
)
def test_walls_are_felt_through_delays_and_after_restarts(felt, least, seed, text) -> None:
    found = ran(read_cell(text), seed)
    assert getattr(found, f"felt_{felt}") > least
    if felt == "last" and seed == 1:
        assert found.drift_mm < 1.0
