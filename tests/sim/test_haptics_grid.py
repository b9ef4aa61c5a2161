"""The corner cells of the grid of `benchmarks haptics`: passive, calm and bounded, or not."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.haptics.cell import MODES, Cell, read_cell
from benchmarks.haptics.claims import claims, needed
from benchmarks.haptics.figures import CellFigures, figures, vectors
from benchmarks.haptics.run import run_cell
from telepresence.haptics.joystick_controller import JoystickController
from telepresence.haptics.passivity import Port
from telepresence.haptics.sample import Feedback

MS = 1_000_000

#: A hard wall under the worst conditions of the radio.
CELLS = (
    Cell(),
    Cell(delay=20.0),
    Cell(delay=100.0),
    Cell(delay=500.0, wall=500.0),
    Cell(jitter=50.0),
    Cell(delay=50.0, loss=30.0, wall=1500.0),
    Cell(delay=100.0, jitter=50.0, loss=30.0, burst=10.0, blackout=1.0),
    Cell(delay=1000.0, jitter=50.0, loss=30.0),
)


def ran(cell: Cell, seed: int = 1) -> CellFigures:
    return figures(cell, *run_cell(cell, seed=seed))


@pytest.fixture(scope="module", params=CELLS, ids=lambda cell: cell.name)
def with_controllers(request) -> CellFigures:
    return ran(request.param)


def test_every_claim_holds(with_controllers) -> None:
    for claim in claims([with_controllers]):
        assert claim.holds, f"{claim.text}: {claim.found}"


def test_the_wall_is_met_and_felt(with_controllers) -> None:
    """A controller that does nothing would be passive too."""
    assert with_controllers.touches >= 2
    assert with_controllers.displayed_peak_n > 3.0


@pytest.mark.parametrize("cell", [CELLS[2], CELLS[5]], ids=lambda cell: cell.name)
def test_without_the_controllers_the_same_cell_makes_energy_and_swings(cell) -> None:
    found = ran(replace(cell, passive="off"))
    assert found.unstable
    assert needed([found]).holds
    assert found.least_uj < -100_000


def test_a_run_repeats() -> None:
    cell = Cell(delay=50.0, jitter=20.0, loss=10.0)
    first, again = ran(cell, seed=3), ran(cell, seed=3)
    assert first == again
    assert ran(cell, seed=4) != first


@pytest.mark.parametrize("wall", [1500.0, 5000.0])
def test_a_blackout_brings_both_ends_to_rest_and_resumption_no_jump(wall) -> None:
    cell = Cell(delay=20.0, blackout=5.0, wall=wall)
    planned, course = run_cell(cell, seed=1)
    tip, displayed, wall_n = vectors(course, "tip"), vectors(course, "motor"), -course["wall_x"]
    for begin, end in ((b // 1_000_000, e // 1_000_000) for b, e in planned.down_dark):
        # The robot receives nothing, so it stops pressing and stands still.
        assert wall_n[end - 100 : end].max() < 0.1
        assert np.ptp(tip[end - 100 : end], axis=0).max() < 1e-4
        assert wall_n[begin] > 1.0
    for _, end in ((b // 1_000_000, e // 1_000_000) for b, e in planned.up_dark):
        # The joystick receives nothing, so it displays only its own damping.
        assert np.abs(displayed[end - 100 : end]).max() < 1.0
    for _, end in {*planned.down_dark, *planned.up_dark}:
        back = slice(end // 1_000_000 - 1, end // 1_000_000 + 500)
        shown = np.hypot(*displayed[back].T)
        assert np.diff(shown).max() < 1.1
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
    assert all(claim.holds for claim in claims([found]))


def test_returned_credit_is_gone() -> None:
    port = Port(reserve_j=0.01, limit_j=0.1)
    port.handle_total(0, MS)
    for step in range(200):
        port.handle_flow(0.003 if step % 3 == 0 else -0.004)
        port.handle_total(900 * step, MS)
        port.return_credit(0.2 * port.credit_j)
        had_j = port.in_j + port.received_j
        assert port.granted_j + port.credit_j + port.out_j + port.forgotten_j == pytest.approx(
            had_j, abs=1e-12
        )


def test_a_cut_force_returns_slowly() -> None:
    """A fast return would be cut again at once, a hundred times a second, and buzz."""
    joystick_side = JoystickController()
    wall, x_m = Feedback(-8.0, 0.0, 0, True), 0.05
    forces = []
    for step in range(400):
        # The hand moves along with a force that nobody paid for; then it rests.
        x_m -= 2e-4 if step < 100 else 0.0
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
    found = figures(cell, planned, course)
    assert 50.0 < found.felt_first < 110.0
    assert 50.0 < found.felt_last < 110.0
    assert found.felt_restart is not None
    for claim in claims([found]):
        assert claim.holds, f"{claim.text}: {claim.found}"


@pytest.mark.parametrize(
    "cell",
    [
        Cell(delay=8.0, wall=100.0, angle=-90.0, place=51.0, hand="reflex", restart="both"),
        Cell(delay=53.0, jitter=38.0, wall=59.0, place=21.0, hand="taps", restart="both"),
        Cell(delay=104.0, wall=98.0, angle=-48.0, place=59.0, hand="loose", restart="both"),
    ],
    ids=lambda cell: cell.name,
)
def test_a_soft_wall_is_felt_1_s_after_both_ends_restart(cell) -> None:
    """The robot has no credit to move, and a tip that rests reveals no wall."""
    found = ran(replace(cell, mode="auto"))
    assert found.felt_restart > 95.0


def test_a_wall_that_is_late_after_a_restart_comes_back_faster() -> None:
    cell = Cell(delay=527.0, wall=1700.0, hand="tremor", restart="joystick", mode="auto")
    assert ran(replace(cell, angle=-90.0, place=47.0, free=3.0), seed=805).felt_restart > 80.0


def test_no_wall_is_told_across_which_the_force_cannot_point() -> None:
    """A soft wall, met aslant, was taken for a steep one at 50 degrees to it."""
    cell = Cell(delay=44.0, loss=18.0, burst=16.0, wall=87.0, place=22.0, hand="arm-1kg")
    assert ran(replace(cell, mode="auto"), seed=829).felt_last > 80.0


def test_a_push_from_near_feels_half_of_its_first_wall() -> None:
    """It brings little energy along, so none may be lost on the way back."""
    cell = Cell(delay=275.0, wall=1900.0, place=21.0, hand="push", mode="auto")
    assert ran(cell).felt_first > 50.0


def test_an_envelope_asks_for_a_press_after_a_restart() -> None:
    cell = Cell(delay=40.0, wall=1500.0, restart="robot", envelope="on")
    planned, course = run_cell(cell, seed=1)
    assert len(course) * MS > planned.end_ns + 500 * MS
    assert figures(cell, planned, course).felt_last > 90.0
