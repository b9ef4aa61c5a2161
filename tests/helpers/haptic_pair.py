"""Both sides of the haptic loop with a delay between them, one millisecond at a time."""

from collections import deque
from collections.abc import Iterator

from telepresence.haptics.bilateral import JoystickSide, RobotSide

MS = 1_000_000


def each_cycle(
    space: JoystickSide, ground: RobotSide, *, count: int, delay_ms: int
) -> Iterator[int]:
    """Yield the number of each cycle before it runs."""
    down, up = deque(), deque()
    for cycle in range(count):
        yield cycle
        now_ns = cycle * MS
        while down and down[0][0] <= now_ns:
            ground.handle_datagram(down.popleft()[1], now_ns)
        while up and up[0][0] <= now_ns:
            space.handle_datagram(up.popleft()[1], now_ns)
        ground.handle_cycle(now_ns, MS)
        space.handle_cycle(now_ns, MS)
        for side, way in ((space, down), (ground, up)):
            sample = side.poll_transmit(now_ns)
            assert sample is not None
            way.append((now_ns + delay_ms * MS, sample))
