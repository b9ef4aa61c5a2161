"""The network of the voice bench: losses and delays of packets, by seed."""

from dataclasses import dataclass
from random import Random

from kontur_av.clock import NS_PER_MS

#: Mean length of a burst of losses, in packets.
BURST_PACKETS = 3.0


@dataclass(frozen=True, kw_only=True)
class Network:
    """A one-way path. loss: the share of packets lost, from 0 to 1.

    bursts: losses come `BURST_PACKETS` in a row on average (Gilbert's model); otherwise they are
    independent. delay_ms: of every packet; jitter_ms: the largest random addition (uniform).
    """

    loss: float
    bursts: bool = False
    delay_ms: float = 5.0
    jitter_ms: float = 5.0
    seed: int = 1

    @property
    def name(self) -> str:
        """Its name in tables."""
        if not self.loss:
            return "none"
        return f"{100 * self.loss:g} %, {'bursts' if self.bursts else 'random'}"

    def lost(self, packets: int, *, spared: int) -> frozenset[int]:
        """The numbers of lost packets, out of `packets`; the first `spared` are never lost."""
        random = Random(f"{self.seed} {self.name}")
        leave = 1 / BURST_PACKETS if self.bursts else 1 - self.loss
        enter = leave * self.loss / (1 - self.loss) if self.bursts else self.loss
        found, bad = set(), False
        for number in range(packets):
            bad = random.random() >= leave if bad else random.random() < enter
            if bad and number >= spared:
                found.add(number)
        return frozenset(found)

    def delays_ns(self, packets: int) -> list[int]:
        """The delay of each packet; with up to 20 ms of jitter no packet overtakes another."""
        random = Random(f"{self.seed} delays")
        return [
            round((self.delay_ms + random.random() * self.jitter_ms) * NS_PER_MS)
            for _ in range(packets)
        ]
