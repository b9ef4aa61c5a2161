"""Both sides of the haptic loop and a path between them, one millisecond at a time."""

from collections.abc import Iterator
from heapq import heappop, heappush
from math import hypot
from random import Random

from telepresence.haptics.bilateral import JoystickSide, RobotSide

MS = 1_000_000


class HapticPair:
    """delay_ms, jitter_ms: of the path, each way. loss: the share of samples that it loses.

    command_delay_ms: on top for commands. cut: the path carries nothing. newest: what each side has
    sent last, None for nothing.
    """

    def __init__(
        self,
        space: JoystickSide | None = None,
        ground: RobotSide | None = None,
        *,
        delay_ms: float = 0,
        jitter_ms: float = 0,
        loss: float = 0.0,
        seed: int = 1,
    ) -> None:
        self.space, self.ground = space or JoystickSide(), ground or RobotSide()
        self.delay_ms, self.jitter_ms, self.loss = delay_ms, jitter_ms, loss
        self.command_delay_ms = 0.0
        self.now_ns = 0
        self.cut = False
        self.newest: dict[JoystickSide | RobotSide, bytes | None] = {}
        self._random = Random(seed)
        self._under_way: list[tuple[int, int, bool, bytes]] = []
        self._sent = 0

    @property
    def robot(self):
        return self.ground.robot

    @property
    def felt_n(self) -> float:
        return hypot(self.space.force_x_n, self.space.force_y_n)

    def step(self) -> None:
        now_ns, way = self.now_ns, self._under_way
        while way and way[0][0] <= now_ns:
            _, _, up, data = heappop(way)
            (self.space if up else self.ground).handle_datagram(data, now_ns)
        for side, up in ((self.ground, True), (self.space, False)):
            side.handle_cycle(now_ns, MS)
            data = self.newest[side] = side.poll_transmit(now_ns)
            if data is None or self.cut or self._random.random() < self.loss:
                continue
            late_ms = self.delay_ms + self._random.random() * self.jitter_ms
            late_ms += 0.0 if up else self.command_delay_ms
            self._sent += 1
            heappush(way, (now_ns + round(late_ms * MS), self._sent, up, data))
        self.now_ns += MS

    def run(self, milliseconds: int) -> None:
        for _ in self.cycles(milliseconds):
            pass

    def cycles(self, count: int) -> Iterator[int]:
        """Yield the number of each cycle before it runs, and once more after the last."""
        for cycle in range(count):
            yield cycle
            self.step()

    def assert_passive(self) -> None:
        for side in (self.space, self.ground):
            assert side.controller.port.least_j >= -1e-6
