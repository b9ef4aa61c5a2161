"""The hands of `benchmarks haptics`: what holds the handle, and how it touches. A core."""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import cos, sin, tau
from random import Random

from kontur_av.clock import NS_PER_S
from telepresence.haptics import hand
from telepresence.haptics.hand import Hand, HandModel, Waypoint


@dataclass(frozen=True, kw_only=True, slots=True)
class BenchHand:
    """model: muscles and mass. taps: it taps at 4 Hz instead of moving freely.

    depth_m: that it intends behind the wall. press_s, back_s: in which it gets there, and retreats.
    tremor_n: amplitude of a tremor of 8 to 12 Hz. reflex_n_m: of a stretch reflex after 50 ms.
    leaves: "limp", it lets its muscles go while it presses; "lets go", of the handle and of the
    dead-man button, too.
    """

    model: HandModel
    taps: bool = False
    depth_m: float = 0.025
    press_s: float = 0.7
    back_s: float = 0.6
    tremor_n: float = 0.0
    reflex_n_m: float = 0.0
    leaves: str = ""


#: By the name in a cell's text.
HANDS: Mapping[str, BenchHand] = {
    "loose": BenchHand(model=hand.LOOSE_GRIP),
    "soft": BenchHand(model=hand.SOFT_GRIP),
    "firm": BenchHand(model=hand.FIRM_GRIP),
    "arm-1kg": BenchHand(model=hand.LIGHT_ARM),
    "arm-2kg": BenchHand(model=hand.HEAVY_ARM),
    "arm-3kg": BenchHand(model=HandModel(stiffness_n_m=600.0, damping_n_s_m=20.0, mass_kg=3.0)),
    "hits": BenchHand(model=hand.SOFT_GRIP, press_s=0.16),
    "push": BenchHand(model=replace(hand.PUSH, push_n=6.0), depth_m=0.035),
    "push-8n": BenchHand(model=replace(hand.PUSH, push_n=8.0), depth_m=0.035),
    "taps": BenchHand(model=hand.SOFT_GRIP, taps=True),
    # Those below are not passive.
    "tremor": BenchHand(model=hand.FIRM_GRIP, tremor_n=3.0),
    "lets-go": BenchHand(model=hand.SOFT_GRIP, leaves="lets go"),
    "pulls-back": BenchHand(model=hand.FIRM_GRIP, back_s=0.12),
    "limp": BenchHand(model=hand.SOFT_GRIP, leaves="limp"),
    "reflex": BenchHand(model=hand.SOFT_GRIP, reflex_n_m=200.0),
}
_REFLEX_MS = 50
#: Damping of a limp arm (N s/m).
_LIMP_N_S_M = 2.0


class HeldHand(Hand):
    """A hand that also does what no passive hand does.

    leaves: number of the waypoint, and the time into it, from which on it is limp or has let go.
    """

    def __init__(
        self, bench: BenchHand, script: Sequence[Waypoint], *, leaves: tuple[int, int], seed: str
    ) -> None:
        super().__init__(bench.model, script=script)
        random = Random(seed)
        self._bench, self._leaves, self._left = bench, leaves, False
        self._tremor_hz, self._tremor_angle = random.uniform(8.0, 12.0), random.uniform(0.0, tau)
        self._stretched: deque[tuple[float, float]] = deque(maxlen=_REFLEX_MS)

    @property
    def place(self) -> tuple[int, int]:
        """Number of its waypoint, and the time into it (ns)."""
        return self._index, self._into_ns

    @property
    def dead_man(self) -> bool:
        return super().dead_man and not (self._left and self._bench.leaves == "lets go")

    def force(
        self, x_m: float, y_m: float, vx_m_s: float, vy_m_s: float, dt_ns: int
    ) -> tuple[float, float]:
        bench, (index, into_ns) = self._bench, self._leaves
        fx, fy = super().force(x_m, y_m, vx_m_s, vy_m_s, dt_ns)
        if bench.leaves and self._index == index and self._into_ns >= into_ns:
            self._left = True
            limp = bench.leaves == "limp"
            self.mass_kg = bench.model.mass_kg if limp else 0.0
            return (-_LIMP_N_S_M * vx_m_s, -_LIMP_N_S_M * vy_m_s) if limp else (0.0, 0.0)
        if self._left:
            # The next movement begins where the handle is by now.
            self._left, self.mass_kg, self._from = False, bench.model.mass_kg, (x_m, y_m)
            return 0.0, 0.0
        if bench.tremor_n:
            wave = sin(tau * self._tremor_hz * self._now_ns / NS_PER_S) * bench.tremor_n
            fx += wave * cos(self._tremor_angle)
            fy += wave * sin(self._tremor_angle)
        if bench.reflex_n_m:
            past = self._stretched
            past.append((self.x_m - x_m, self.y_m - y_m))
            fx += bench.reflex_n_m * past[0][0]
            fy += bench.reflex_n_m * past[0][1]
        return fx, fy
