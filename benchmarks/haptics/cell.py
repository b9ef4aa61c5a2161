"""One cell of the grid of `python -m benchmarks haptics`: a channel, a wall and a hand."""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, fields
from itertools import product
from typing import Any, ClassVar

from benchmarks.haptics.hands import DEFAULT_HAND, HANDS
from kontur_av.errors import ConfigError

#: The names in a cell's text, with least and largest value and the unit.
_LIMITS = {
    "delay": (0.0, 1000.0, "ms, there and back"),
    "jitter": (0.0, 50.0, "ms"),
    "loss": (0.0, 30.0, "%"),
    "burst": (1.0, 1000.0, "samples"),
    "blackout": (0.0, 5.0, "s"),
    "wall": (1.0, 5000.0, "N/m"),
    "angle": (-180.0, 180.0, "degrees"),
    "place": (15.0, 65.0, "mm"),
    "free": (0.0, 60.0, "s"),
}


@dataclass(frozen=True, kw_only=True, slots=True)
class Cell:
    """The channel between hand and wall, the wall, and the hand.

    delay: of the round trip (ms), half of it each way. jitter: largest random addition to the delay
    of a sample (ms, uniform), so samples overtake each other. loss: of samples each way (%), in
    bursts of `burst` samples on average (1: independent). blackout: length (s) of each of three
    outages, of both ways, of the commands alone and of the feedback alone; 0: none. wall: its
    stiffness (N/m). hand: one of `HANDS`.
    """

    delay: float = 0.0
    jitter: float = 0.0
    loss: float = 0.0
    burst: float = 1.0
    blackout: float = 0.0
    wall: float = 5000.0
    hand: str = DEFAULT_HAND

    #: The words that each text may be.
    words: ClassVar[Mapping[str, Collection[str]]] = {"hand": HANDS}

    def __post_init__(self) -> None:
        for field in fields(self):
            name, value = field.name, getattr(self, field.name)
            if name in self.words:
                if value not in self.words[name]:
                    raise ConfigError(
                        f"cell: {name}={value} is none of {', '.join(self.words[name])}"
                    )
                continue
            least, most, unit = _LIMITS[name]
            if not least <= value <= most:
                raise ConfigError(f"cell: {name}={value:g} is out of {least:g} to {most:g} {unit}")

    @property
    def channel(self) -> str:
        """The cell without its delay, its wall and its hand, for tables."""
        parts = [f"jitter {self.jitter:g} ms"] if self.jitter else []
        if self.loss:
            bursts = f" in bursts of {self.burst:g}" if self.burst > 1 else ""
            parts.append(f"loss {self.loss:g} %{bursts}")
        if self.blackout:
            parts.append(f"blackouts {self.blackout:g} s")
        return ", ".join(parts) or "clean"

    @property
    def name(self) -> str:
        """The cell, for tables and charts."""
        hand = "" if self.hand == DEFAULT_HAND else f", {self.hand}"
        return f"{self.delay:g} ms, wall {self.wall / 1000:g} kN/m, {self.channel}{hand}"


def read_cell(text: str, kind: type[Cell] = Cell) -> Cell:
    """The cell of a text like `delay=100,wall=5000`; other values are the defaults of `kind`.

    ConfigError for an unknown name, no number, or a value out of range.
    """
    known = [field.name for field in fields(kind)]
    values: dict[str, Any] = {}
    for part in text.split(","):
        name, equals, value = part.strip().partition("=")
        if not equals or name not in known:
            raise ConfigError(f"cell {text}: give NAME=VALUE of {', '.join(known)}")
        try:
            values[name] = value if name in kind.words else float(value)
        except ValueError:
            raise ConfigError(f"cell {text}: {name} wants a number") from None
    return kind(**values)


#: Loss (%) and burst of the full grid: none, independent, and in bursts.
_LOSSES = ((0.0, 1.0), (10.0, 1.0), (30.0, 1.0), (30.0, 10.0))
_JITTERS = (0.0, 10.0, 50.0)
_BLACKOUTS = (0.0, 0.5, 5.0)


def small_grid() -> Iterator[Cell]:
    """The corners and a middle with the default hand, and three channels with each other: 54."""
    for delay, wall in product((0.0, 50.0, 250.0, 1000.0), (500.0, 1500.0, 5000.0)):
        yield Cell(delay=delay, wall=wall)
        yield Cell(delay=delay, wall=wall, jitter=50.0, loss=30.0)
        yield Cell(delay=delay, wall=wall, jitter=50.0, loss=30.0, burst=10.0, blackout=5.0)
    for hand in HANDS:
        if hand != DEFAULT_HAND:
            yield Cell(delay=50.0, wall=5000.0, hand=hand)
            yield Cell(delay=250.0, wall=1500.0, hand=hand)
            yield Cell(delay=50.0, wall=5000.0, loss=30.0, burst=10.0, hand=hand)


_DELAYS = (0.0, 20.0, 50.0, 100.0, 300.0, 1000.0)
_WALLS = (500.0, 1500.0, 5000.0)


def full_grid() -> Iterator[Cell]:
    """Every hand on a clean channel, then every other channel with the hands in turn: 756 cells.

    The hands turn so that each meets each value of each axis about equally often. With every hand
    in every cell it would be 4536.
    """
    for delay, wall, hand in product(_DELAYS, _WALLS, HANDS):
        yield Cell(delay=delay, wall=wall, hand=hand)
    hands = tuple(HANDS)
    for (a, delay), (b, wall), (c, jitter), (d, (loss, burst)), (e, blackout) in product(
        enumerate(_DELAYS),
        enumerate(_WALLS),
        enumerate(_JITTERS),
        enumerate(_LOSSES),
        enumerate(_BLACKOUTS),
    ):
        if not (jitter or loss or blackout):
            continue
        yield Cell(
            delay=delay,
            wall=wall,
            jitter=jitter,
            loss=loss,
            burst=burst,
            blackout=blackout,
            # Another factor for each axis, so that no axis decides the hand.
            hand=hands[(a + 2 * b + 3 * c + 4 * d + 5 * e) % len(hands)],
        )
