"""The hands of `benchmarks haptics`: what holds the handle, and how it touches. A core."""

from collections.abc import Mapping
from dataclasses import dataclass

from telepresence.haptics.hand import (
    FIRM_GRIP,
    HEAVY_ARM,
    LIGHT_ARM,
    LOOSE_GRIP,
    PUSH,
    SOFT_GRIP,
    HandModel,
)


@dataclass(frozen=True, kw_only=True, slots=True)
class BenchHand:
    """model: muscles and mass. taps: it taps at 4 Hz instead of touching slowly."""

    model: HandModel
    taps: bool = False


DEFAULT_HAND = "soft"
#: By the name in a cell's text.
HANDS: Mapping[str, BenchHand] = {
    "loose": BenchHand(model=LOOSE_GRIP),
    "soft": BenchHand(model=SOFT_GRIP),
    "firm": BenchHand(model=FIRM_GRIP),
    "arm-1kg": BenchHand(model=LIGHT_ARM),
    "arm-2kg": BenchHand(model=HEAVY_ARM),
    "push": BenchHand(model=PUSH),
    "taps": BenchHand(model=SOFT_GRIP, taps=True),
}
