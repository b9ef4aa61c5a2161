"""The claims about the hand's controllers, checked against figures. A core."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from benchmarks.haptics.cell import MODES
from benchmarks.haptics.haptics_metrics import STEP_N, SWING_N, CellMetrics

#: Energy totals are sent in whole µJ, rounded down.
ROUNDING_UJ = 1.0
#: What the motors may give the hand for nothing, at each start of the joystick (mJ).
START_MJ = 50.0
#: Largest change of the force on the hand in 1 ms.
RISE_N_MS = STEP_N


@dataclass(frozen=True, slots=True)
class Claim:
    """text: the claim. found: in words. holds: whether it is true."""

    text: str
    found: str
    holds: bool


def claims(found: Sequence[CellMetrics]) -> list[Claim]:
    """The claims about each mode with its controllers, each checked on the worst cell."""
    made: list[Claim] = []
    for mode in dict.fromkeys(metrics.cell.mode for metrics in found):
        rows = [f for f in found if (f.cell.mode, f.cell.passive) == (mode, "on")]
        for text, unit, value, most in _bounds(mode) if rows else ():
            worst = max(rows, key=value)
            broken = sum(value(metrics) > most for metrics in rows)
            words = f"{broken} of {len(rows)} break it; most {value(worst):.2f} {unit}"
            made.append(Claim(f"{mode}: {text}", f"{words}: {worst.cell.name}", not broken))
    return made


_Bound = tuple[str, str, Callable[[CellMetrics], float], float]


def _bounds(mode: str) -> Iterator[_Bound]:
    """(claim, unit, value, bound) of a mode."""
    text = f"a port's observed energy is never below -{ROUNDING_UJ:g} µJ"
    yield text, "µJ", lambda f: -f.least_uj, ROUNDING_UJ
    if not MODES[mode]:
        yield "the network never makes energy", "µJ", lambda f: f.network_uj, ROUNDING_UJ
    else:
        # A rendered wall gives back what the hand put in, while the robot presses with as much.
        yield "the robot gets no more than the hand put in", "µJ", lambda f: f.robot_uj, ROUNDING_UJ
        text = f"the motors give at most {START_MJ:g} mJ a start more than they took"
        yield text, "mJ", lambda f: f.motors_mj / f.joystick_lives, START_MJ
    text = "the contact force stays below that of a tip that only follows the hand"
    yield text, "N beyond", lambda f: f.contact_peak_n - f.contact_bound_n, 0.0
    text = f"with a still hand no force keeps oscillating by more than {SWING_N:g} N"
    yield text, "N", lambda f: (f.swing_n or 0.0) if f.unstable else 0.0, SWING_N
    text = f"the force on the hand changes by at most {RISE_N_MS:g} N in 1 ms"
    yield text, "N", lambda f: f.step_n_ms, RISE_N_MS


def needed(without: Sequence[CellMetrics]) -> Claim:
    """The claim that the controllers are needed, checked on runs without them."""
    swung = sum(f.unstable for f in without)
    made = sum(f.network_uj > ROUNDING_UJ for f in without)
    return Claim(
        "without the controllers the network makes energy, and forces oscillate",
        f"energy in {made}, oscillation in {swung} of {len(without)} cells",
        made > 0 and swung > 0,
    )
