"""One cell of the grids of `python -m benchmarks haptics`: channel, wall, hand and events."""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, fields, replace
from math import cos, radians, sin
from pathlib import Path
from random import Random
from typing import Any, ClassVar

from benchmarks.haptics.hands import HANDS, BenchHand
from kontur_av.errors import ConfigError

#: The modes of the hand, with the keywords of `JoystickSide` and `RobotSide` that turn each on.
MODES: Mapping[str, Mapping[str, bool]] = {
    "direct": {},
    "deadband": {},
    "mediated": {"mediated": True},
    "auto": {"mediated": True, "residual": True},
}
#: Round trips (ms) by which random cells are drawn, and cells are grouped.
BANDS = ((0, 60), (60, 150), (150, 300), (300, 500), (500, 800))
BAND_NAMES = (*(f"{low}-{high} ms" for low, high in BANDS), "over 800 ms")
_ENDS = ("none", "joystick", "robot", "both")

#: The names in a cell's text, with least and largest value and the unit.
_LIMITS = {
    "delay": (0.0, 1000.0, "ms, there and back"),
    "jitter": (0.0, 50.0, "ms"),
    "loss": (0.0, 30.0, "%"),
    "burst": (1.0, 1000.0, "samples"),
    "blackout": (0.0, 5.0, "s"),
    "copies": (0.0, 30.0, "%"),
    "wall": (1.0, 5000.0, "N/m"),
    "damping": (0.0, 200.0, "N s/m"),
    "friction": (0.0, 0.6, ""),
    "angle": (-180.0, 180.0, "degrees"),
    "place": (15.0, 65.0, "mm"),
    "free": (0.0, 60.0, "s"),
}


@dataclass(frozen=True, kw_only=True, slots=True)
class Cell:
    """The channel between hand and wall, the wall, the hand, and what happens.

    delay: of the round trip (ms), half of it each way. jitter: largest random addition to the delay
    of a sample (ms, uniform), so samples overtake each other. loss: of samples each way (%), in
    bursts of `burst` samples on average (1: independent). blackout: length (s) of each of three
    outages, of both ways, of the commands alone and of the feedback alone; 0: none. copies: of the
    samples (%), up to 200 ms later.

    wall, damping, friction: its stiffness (N/m), damping (N s/m) and Coulomb coefficient. angle: of
    the direction in which the tip meets it (degrees; 0: along x). place: its distance from the
    middle (mm). hand: one of `HANDS`. free: free motion before the first press (s). restart: the
    end that starts anew at `contact`, in the second press, or `free`, before it. mode: of the hand.
    envelope: the safety envelope is in the loop and asks for presses. passive: `off` leaves the
    passivity controllers out.
    """

    delay: float = 0.0
    jitter: float = 0.0
    loss: float = 0.0
    burst: float = 1.0
    blackout: float = 0.0
    copies: float = 0.0
    wall: float = 5000.0
    damping: float = 20.0
    friction: float = 0.15
    angle: float = 0.0
    place: float = 60.0
    hand: str = "soft"
    free: float = 0.0
    restart: str = "none"
    at: str = "contact"
    mode: str = "direct"
    envelope: str = "off"
    passive: str = "on"

    #: The words that each text may be.
    words: ClassVar[Mapping[str, Collection[str]]] = {
        "hand": HANDS,
        "restart": _ENDS,
        "at": ("contact", "free"),
        "mode": MODES,
        "envelope": ("off", "on"),
        "passive": ("on", "off"),
    }

    def __post_init__(self) -> None:
        for field in fields(self):
            name, value = field.name, getattr(self, field.name)
            least, most, unit = _LIMITS.get(name, (0.0, 0.0, ""))
            if name in self.words:
                if value not in (words := self.words[name]):
                    raise ConfigError(f"cell: {name}={value} is none of {', '.join(words)}")
            elif not least <= value <= most:
                raise ConfigError(f"cell: {name}={value:g} is out of {least:g} to {most:g} {unit}")

    @property
    def name(self) -> str:
        """The text that `--cell` takes: delay, wall and what differs from the defaults."""
        told = [(field.name, getattr(self, field.name), field.default) for field in fields(self)]
        told = [each for each in told if each[1] != each[2] or each[0] in ("delay", "wall")]
        return ",".join(f"{n}={v if isinstance(v, str) else f'{v:g}'}" for n, v, _ in told)

    @property
    def setting(self) -> str:
        """The name without mode and controllers: their channels and hands are alike."""
        return replace(self, mode="direct", passive="on").name

    @property
    def who(self) -> str:
        """Its controllers, for tables."""
        return self.mode if self.passive == "on" else f"{self.mode}, without controllers"

    @property
    def band(self) -> str:
        """The band of its round trip, for tables."""
        return BAND_NAMES[sum(self.delay > high for _, high in BANDS)]

    @property
    def normal(self) -> tuple[float, float]:
        """The direction in which the tip meets the wall."""
        return cos(radians(self.angle)), sin(radians(self.angle))

    @property
    def bench_hand(self) -> BenchHand:
        return HANDS[self.hand]


def read_cell(text: str) -> Cell:
    """The cell of a text like `delay=100,wall=5000`; other values are the defaults of `Cell`.

    ConfigError for an unknown name, no number, or a value out of range.
    """
    known = [field.name for field in fields(Cell)]
    values: dict[str, Any] = {}
    for part in text.split(","):
        name, equals, value = part.strip().partition("=")
        if not equals or name not in known:
            raise ConfigError(f"--cell {text}: give NAME=VALUE of {', '.join(known)}")
        try:
            values[name] = value if name in Cell.words else float(value)
        except ValueError:
            raise ConfigError(f"--cell {text}: {name} wants a number") from None
    return Cell(**values)


def kept_cells(name: str) -> list[Cell]:
    """The cells of a file of texts in this folder."""
    texts = (Path(__file__).parent / name).read_text(encoding="utf-8").split()
    return [read_cell(text) for text in texts]


def random_cells(number: int, *, seed: int) -> Iterator[Cell]:
    """`number` cells in direct mode, drawn from `seed` alone."""
    for each in range(number):
        random = Random(f"{seed} {each}")
        low, high = BANDS[each % len(BANDS)]
        loss = round(random.choice((0.0, random.uniform(0.0, 20.0))))
        burst = random.choice((1, 1, random.randint(2, 20)))
        yield Cell(
            delay=round(random.uniform(low, high)),
            jitter=round(random.choice((0.0, random.uniform(0.0, 50.0)))),
            loss=loss,
            burst=burst if loss else 1,
            blackout=random.choice((0.0, 0.0, 0.0, round(random.uniform(0.2, 3.0), 1))),
            wall=float(f"{50.0 * 40.0 ** random.random():.2g}"),
            angle=random.choice((-90, 0, 90, 180, *(random.randint(-179, 180) for _ in range(8)))),
            place=random.randint(15, 65),
            hand=random.choice(tuple(HANDS)),
            free=random.choice((0.0, 3.0)),
            restart=random.choice(("none", *_ENDS)),
            at=random.choice(("contact", "free")),
            damping=random.choice((20.0, 0.0, 5.0, 40.0, random.randint(0, 150))),
            friction=random.choice((0.15, 0.0, 0.4)),
            copies=random.choice((0.0, 0.0, 0.0, 20.0)),
        )
