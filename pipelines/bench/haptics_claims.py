"""What is claimed of the bilateral controller, held against figures."""

from collections.abc import Sequence
from dataclasses import dataclass

from pipelines.bench.haptics_figures import SWING_N, Figures

#: Of a total, which is sent in whole µJ, rounded down.
ROUNDING_UJ = 1.0
CONTACT_N = 35.0
JUMP_N_MS = 1.0
DRIFT_MM = 1.0


@dataclass(frozen=True, slots=True)
class Claim:
    """A sentence, what was found, and whether it holds."""

    text: str
    found: str
    holds: bool


def claims(without: Sequence[Figures], with_: Sequence[Figures]) -> list[Claim]:
    """All claims, each on the worst cell; the same cells in both, in the same order."""
    least = min(with_, key=_least_uj)
    given = max(with_, key=lambda f: f.given_uj)
    contact = max(with_, key=lambda f: f.contact_peak_n)
    jump = max(with_, key=lambda f: f.jump_n_ms)
    drift = max(with_, key=lambda f: f.drift_mm)
    swings = [f for f in with_ if f.unstable]
    swung = [f for f in without if f.unstable]
    made = sum(f.given_uj > ROUNDING_UJ for f in without)
    found = [
        Claim(
            f"observed energy at either port is never below -{ROUNDING_UJ:g} µJ",
            f"{_least_uj(least):.2f} µJ: {least.cell.name}",
            _least_uj(least) >= -ROUNDING_UJ,
        ),
        Claim(
            "in all, the network never gives out more energy than it got",
            f"{given.given_uj:.2f} µJ: {given.cell.name}",
            given.given_uj <= ROUNDING_UJ,
        ),
        Claim(
            f"the wall is never pressed with more than {CONTACT_N:g} N",
            f"{contact.contact_peak_n:.1f} N: {contact.cell.name}",
            contact.contact_peak_n <= CONTACT_N,
        ),
        Claim(
            f"on a still hand no force swings on by more than {SWING_N:g} N",
            f"{len(swings)} of {len(with_)}" + (f": {swings[0].cell.name}" if swings else ""),
            not swings,
        ),
        Claim(
            f"the force on the hand never changes by more than {JUMP_N_MS:g} N in 1 ms",
            f"{jump.jump_n_ms:.2f} N: {jump.cell.name}",
            jump.jump_n_ms <= JUMP_N_MS + 1e-9,
        ),
        Claim(
            f"free again and at rest, tip and handle are within {DRIFT_MM:g} mm",
            f"{drift.drift_mm:.2f} mm: {drift.cell.name}",
            drift.drift_mm <= DRIFT_MM,
        ),
    ]
    found.append(
        Claim(
            "without the controllers the network makes energy, and forces swing on",
            f"it makes energy in {made}, swings on in {len(swung)} of {len(without)}",
            made > 0 and bool(swung),
        )
    )
    return found


def _least_uj(figures: Figures) -> float:
    return min(figures.least_master_uj, figures.least_slave_uj)
