"""The claims about the hand's controllers, checked against figures. A core."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from benchmarks.haptics.figures import STEP_N, SWING_N, CellFigures
from benchmarks.haptics.trial_figures import TrialFigures

#: Energy totals are sent in whole µJ, rounded down.
ROUNDING_UJ = 1.0
#: What the motors may give the hand for nothing, at each start of the joystick (mJ).
START_MJ = 50.0
#: Largest change of the received force at the joystick side, and of its damping.
RISE_N_MS = STEP_N


@dataclass(frozen=True, slots=True)
class Claim:
    """text: the claim. found: in words. holds: whether it is true."""

    text: str
    found: str
    holds: bool


def claims(with_: Sequence[CellFigures]) -> list[Claim]:
    """The claims about the passivity controllers, each checked on the worst of these runs."""
    least = min(with_, key=_least_uj)
    given = max(with_, key=lambda f: f.given_uj)
    contact = max(with_, key=lambda f: f.contact_peak_n / f.contact_bound_n)
    rise = max(with_, key=lambda f: f.rise_n_ms)
    drop = max(with_, key=lambda f: f.drop_n_ms)
    swing = max(with_, key=lambda f: f.swing_n)
    swings = [f for f in with_ if f.unstable]
    return [
        Claim(
            f"observed energy at either port is never below -{ROUNDING_UJ:g} µJ",
            f"{_least_uj(least):.2f} µJ: {least.cell.name}",
            _least_uj(least) >= -ROUNDING_UJ,
        ),
        Claim(
            "in total, the network never gives out more energy than it received",
            f"{given.given_uj:.2f} µJ: {given.cell.name}",
            given.given_uj <= ROUNDING_UJ,
        ),
        Claim(
            "the contact force stays below that of a tip that only follows the hand",
            f"{contact.contact_peak_n:.1f} N, bound {contact.contact_bound_n:.1f} N: "
            f"{contact.cell.name}",
            contact.contact_peak_n <= contact.contact_bound_n,
        ),
        Claim(
            f"with a still hand no force keeps oscillating by more than {SWING_N:g} N",
            f"{len(swings)} of {len(with_)}; most {swing.swing_n:.2f} N: {swing.cell.name}",
            not swings,
        ),
        Claim(
            f"the force on the hand never grows by more than {RISE_N_MS:g} N in 1 ms",
            f"{rise.rise_n_ms:.2f} N: {rise.cell.name}",
            rise.rise_n_ms <= RISE_N_MS,
        ),
        Claim(
            f"the force on the hand never falls by more than {RISE_N_MS:g} N in 1 ms",
            f"{sum(f.drops > 0 for f in with_)} of {len(with_)}; most {drop.drop_n_ms:.2f} N: "
            f"{drop.cell.name}",
            drop.drop_n_ms <= RISE_N_MS,
        ),
    ]


def needed(without: Sequence[CellFigures]) -> Claim:
    """The claim that the controllers are needed, checked on runs without them."""
    swung = sum(f.unstable for f in without)
    made = sum(f.given_uj > ROUNDING_UJ for f in without)
    return Claim(
        "without the controllers the network makes energy, and forces oscillate",
        f"energy in {made}, oscillation in {swung} of {len(without)} cells",
        made > 0 and swung > 0,
    )


def _least_uj(figures: CellFigures) -> float:
    return min(figures.least_joystick_uj, figures.least_robot_uj)


_Bound = tuple[str, str, Callable[[TrialFigures], float], float]

_EVERY_MODE: tuple[_Bound, ...] = (
    (
        f"on a still hand no force swings on by more than {SWING_N:g} N",
        "N",
        lambda f: f.swing_n or 0.0,
        SWING_N,
    ),
    (f"the force changes by at most {STEP_N:g} N in 1 ms", "N", lambda f: f.step_n_ms, STEP_N),
)
_DELAYED_FORCE: tuple[_Bound, ...] = (
    ("the network never makes energy", "µJ", lambda f: f.network_uj, ROUNDING_UJ),
)
#: A rendered wall gives back what the hand put into it, while the robot presses with as much.
_RENDERED_WALL: tuple[_Bound, ...] = (
    ("the robot never gets more than the hand put in", "µJ", lambda f: f.robot_uj, ROUNDING_UJ),
    (
        f"the motors give at most {START_MJ:g} mJ more than they took, a start",
        "mJ",
        lambda f: f.motors_mj / f.trial.joystick_lives,
        START_MJ,
    ),
)


def trial_claims(found: Sequence[TrialFigures]) -> list[Claim]:
    """The claims about each mode in trials, each checked on the worst of them."""
    made = []
    for mode in dict.fromkeys(figures.trial.mode for figures in found):
        rows = [figures for figures in found if figures.trial.mode == mode]
        of_mode = _DELAYED_FORCE if mode in ("direct", "deadband") else _RENDERED_WALL
        for text, unit, value, most in (*_EVERY_MODE, *of_mode):
            worst = max(rows, key=value)
            broken = sum(value(figures) > most for figures in rows)
            found_text = f"{broken} of {len(rows)} break it; most {value(worst):.2f} {unit}"
            made.append(Claim(f"{mode}: {text}", f"{found_text}: {worst.trial.name}", not broken))
    return made
