"""Whatever hand holds the handle: no force swings on, none drops, and walls are felt."""

import pytest

from benchmarks.haptics.cell import Cell
from benchmarks.haptics.claims import claims
from benchmarks.haptics.figures import STEP_N, CellFigures, figures
from benchmarks.haptics.hands import HANDS, BenchHand
from benchmarks.haptics.run import run_cell
from telepresence.haptics.hand import HandModel

#: Stiffness (N/m), damping (N s/m), mass (kg), and a cell; a controller that switched its force
#: off and slowly on again swung in each of them by 2 to 3 N for ever.
CHATTERING = (
    (500.0, 35.0, 1.5, Cell(delay=50.0, wall=5000.0)),
    (500.0, 13.4, 1.0, Cell(delay=100.0, wall=1500.0)),
    (800.0, 24.0, 2.0, Cell(delay=50.0, wall=5000.0)),
    (700.0, 35.0, 0.4, Cell(delay=20.0, wall=5000.0, loss=30.0, burst=10.0)),
)


def ran(cell: Cell) -> CellFigures:
    return figures(cell, *run_cell(cell, seed=1))


@pytest.mark.parametrize(("stiffness", "damping", "mass", "cell"), CHATTERING)
def test_no_force_swings_on_at_any_hand(stiffness, damping, mass, cell, monkeypatch) -> None:
    model = HandModel(stiffness_n_m=stiffness, damping_n_s_m=damping, mass_kg=mass)
    monkeypatch.setitem(HANDS, "soft", BenchHand(model=model))  # type: ignore[arg-type]
    found = ran(cell)
    for claim in claims([found]):
        assert claim.holds, f"{claim.text}: {claim.found}"


@pytest.mark.parametrize("hand", ["arm-2kg", "push", "taps"])
@pytest.mark.parametrize("delay", [20.0, 300.0])
def test_no_force_drops_suddenly(hand, delay) -> None:
    cell = Cell(delay=delay, wall=1500.0, hand=hand)
    found = ran(cell)
    assert found.step_n_ms <= STEP_N
    for claim in claims([found]):
        assert claim.holds, f"{claim.text}: {claim.found}"


@pytest.mark.parametrize("hand", ["soft", "firm"])
def test_a_wall_is_felt_through_a_long_delay(hand) -> None:
    """It was 45 and 75 N/m of 600 when the damping did not follow the credit."""
    cell = Cell(delay=300.0, wall=1500.0, hand=hand)
    found = ran(cell)
    assert found.felt_last > 60.0
    assert found.drift_mm < 1.0
