"""The radio path: frames arrive after a delay, or never."""

from collections import deque
from random import Random
from typing import Any


class RadioPath:
    """A delay line with optional independent frame loss; `handle_frame`, then `poll_transmit`.

    delay_ns: from `handle_frame` to the moment at which `poll_transmit` gives the frame out.
    loss: probability from 0 to 1 that a frame gets lost; `seed` makes the losses repeatable.
    """

    def __init__(self, *, delay_ns: int = 0, loss: float = 0.0, seed: int = 0) -> None:
        if delay_ns < 0 or not 0.0 <= loss <= 1.0:
            raise ValueError("delay_ns must not be negative, loss must be from 0 to 1")
        self.delay_ns = delay_ns
        self._loss = loss
        self._random = Random(seed)
        self._under_way: deque[tuple[int, bytes]] = deque()
        self.frames_sent = 0
        self.frames_lost = 0

    def handle_frame(self, frame: bytes, now_ns: int) -> None:
        """A frame leaves the antenna."""
        self.frames_sent += 1
        if self._loss and self._random.random() < self._loss:
            self.frames_lost += 1
            return
        self._under_way.append((now_ns + self.delay_ns, frame))

    def poll_transmit(self, now_ns: int) -> bytes | None:
        """The next frame that has arrived by `now_ns`. Call until None."""
        if self._under_way and self._under_way[0][0] <= now_ns:
            return self._under_way.popleft()[1]
        return None

    def poll_timeout(self) -> int | None:
        """When the next frame arrives."""
        return self._under_way[0][0] if self._under_way else None

    def report(self) -> dict[str, Any]:
        return {
            "delay_ns": self.delay_ns,
            "frames_sent": self.frames_sent,
            "frames_lost": self.frames_lost,
            "frames_under_way": len(self._under_way),
        }
