"""The radio path: frames arrive after a delay, with flipped bits, or not at all."""

from collections import deque
from math import inf, log1p
from random import Random

from telepresence.link.link_metrics import PathMetrics
from telepresence.link.radio.channel import FOREVER_NS, Condition, RadioChannel

_STEADY = Condition()


def hazard(probability: float) -> float:
    """Return -ln(1 - p): what one trial uses up of the exponentially distributed error budget."""
    return -log1p(-probability) if probability < 1.0 else inf


class RadioPath:
    """A delay line with errors; call `handle_frame`, then `poll_transmit`.

    delay_ns: time from `handle_frame` until `poll_transmit` returns the frame.
    loss: probability, 0 to 1, that a frame is lost.
    seed: makes losses and errors repeatable.
    channel: additional delay and errors that change with time; see `RadioProfile.path`.
    epoch_ns: the instant at which the channel's time is 0.

    Instants must not go back. Equal seeds and calls give equal frames. A frame that arrives has its
    full length and its order; some of its bits may be flipped.

    Each frame subtracts its hazard, -ln(1 - p) for the frame and for each bit, from a store that is
    exponentially distributed. An error occurs only where the store is used up.
    """

    def __init__(
        self,
        *,
        delay_ns: int = 0,
        loss: float = 0.0,
        seed: int | str = 0,
        channel: RadioChannel | None = None,
        epoch_ns: int = 0,
    ) -> None:
        if delay_ns < 0 or not 0.0 <= loss <= 1.0:
            raise ValueError("delay_ns must not be negative, loss must be from 0 to 1")
        self._random = Random(seed)
        self._store = self._random.expovariate(1.0)
        self._fixed_delay_ns = self._delay_ns = delay_ns
        self._fixed_hazard = self._per_frame = hazard(loss)
        self._per_octet = 0.0
        self._risky = self._per_frame > 0.0
        self._slope = 0.0
        self._channel = channel
        self._epoch_ns = epoch_ns
        self._since_ns = 0
        self._until_ns = FOREVER_NS if channel is None else -FOREVER_NS
        self._outage_ns = -FOREVER_NS
        self._open = True
        self._no_signal = False
        self._no_signal_ns = 0
        self._now_ns = epoch_ns
        self._arrival_ns = -FOREVER_NS
        self._least_ns, self._most_ns = FOREVER_NS, -1
        self._under_way: deque[tuple[int, bytes]] = deque()
        self.frames_sent = 0
        self.frames_lost = 0
        self.frames_hit = 0
        self.bits_flipped = 0

    @property
    def delay_ns(self) -> int:
        """The delay of a frame sent at the instant of the last frame."""
        return self._delay_ns + int((self._now_ns - self._since_ns) * self._slope)

    def handle_frame(self, frame: bytes, now_ns: int) -> None:
        """A frame is sent."""
        if now_ns >= self._until_ns:
            self._change(now_ns)
        self._now_ns = now_ns
        self.frames_sent += 1
        if self._risky:
            left = self._store - self._per_frame - len(frame) * self._per_octet
            if left < 0.0:
                struck = self._strike(frame)
                if struck is None:
                    self.frames_lost += 1
                    return
                frame = struck
            else:
                self._store = left
        arrival_ns = now_ns + self._delay_ns
        if self._slope:
            arrival_ns += int((now_ns - self._since_ns) * self._slope)
        if arrival_ns < self._arrival_ns:
            # Rounding between two segments of the delay may differ by a nanosecond.
            arrival_ns = self._arrival_ns
        self._arrival_ns = arrival_ns
        self._under_way.append((arrival_ns, frame))

    def arrival_ns(self, now_ns: int) -> int:
        """When a frame that is sent at `now_ns`, and not lost, arrives."""
        if now_ns >= self._until_ns:
            self._change(now_ns)
        delay_ns = self._delay_ns + int((now_ns - self._since_ns) * self._slope)
        return max(now_ns + delay_ns, self._arrival_ns)

    def handle_outage(self, until_ns: int, now_ns: int) -> None:
        """From the next frame on nothing gets through, until `until_ns`; a past one ends it."""
        self._outage_ns = until_ns
        # The next frame finds the condition changed.
        self._until_ns = min(self._until_ns, now_ns)

    def poll_transmit(self, now_ns: int) -> bytes | None:
        """The next frame that has arrived by `now_ns`, or None. Call until None."""
        if self._under_way and self._under_way[0][0] <= now_ns:
            return self._under_way.popleft()[1]
        return None

    def poll_timeout(self) -> int | None:
        """When the next frame arrives."""
        return self._under_way[0][0] if self._under_way else None

    def report(self) -> PathMetrics:
        """Counts, and the delay now, least and most; with a channel its outages and contact."""
        if self.frames_sent:
            self._note_delay()
        channel, now_ns = self._channel, self._now_ns
        silent_ns = None if channel is None else self._no_signal_ns + self._silent_ns(now_ns)
        return PathMetrics(
            delay_ns=self.delay_ns,
            delay_min_ns=min(self._least_ns, self.delay_ns),
            delay_max_ns=max(self._most_ns, self.delay_ns),
            frames_sent=self.frames_sent,
            frames_lost=self.frames_lost,
            frames_hit=self.frames_hit,
            bits_flipped=self.bits_flipped,
            frames_under_way=len(self._under_way),
            no_signal_ns=silent_ns,
            channel=None if channel is None else channel.report(now_ns - self._epoch_ns),
        )

    def _note_delay(self) -> None:
        delay_ns = self.delay_ns
        self._least_ns = min(self._least_ns, delay_ns)
        self._most_ns = max(self._most_ns, delay_ns)

    def _silent_ns(self, now_ns: int) -> int:
        return min(now_ns, self._until_ns) - self._since_ns if self._no_signal else 0

    def _change(self, now_ns: int) -> None:
        if self.frames_sent:
            self._note_delay()
            self._no_signal_ns += self._silent_ns(now_ns)
        condition = _STEADY
        if self._channel is not None:
            condition = self._channel.condition(now_ns - self._epoch_ns)
        self._since_ns, self._until_ns = now_ns, condition.until_ns + self._epoch_ns
        outage = now_ns < self._outage_ns
        if outage:
            self._until_ns = min(self._until_ns, self._outage_ns)
        self._delay_ns = self._fixed_delay_ns + round(condition.delay_ns)
        self._slope = condition.slope
        self._open = not (outage or condition.blackout or condition.no_signal)
        self._no_signal = condition.no_signal
        per_frame = self._fixed_hazard + hazard(condition.frame_loss)
        self._per_frame = per_frame if self._open else inf
        self._per_octet = 8 * hazard(condition.bit_error_rate)
        self._risky = self._per_frame > 0.0 or self._per_octet > 0.0
        self._now_ns = now_ns
        self._note_delay()

    def _strike(self, frame: bytes) -> bytes | None:
        """The store ran out within this frame: lose it, or flip some of its bits."""
        if not self._open:
            return None
        at = self._store - self._per_frame
        draw = self._random.expovariate
        if at < 0.0:
            self._store = draw(1.0)
            return None
        per_bit = self._per_octet / 8
        bits = 8 * len(frame)
        octets = bytearray(frame)
        while at < bits * per_bit:
            bit = min(int(at / per_bit), bits - 1)
            octets[bit >> 3] ^= 0x80 >> (bit & 7)
            self.bits_flipped += 1
            at = (bit + 1) * per_bit + draw(1.0)
        self._store = at - bits * per_bit
        self.frames_hit += 1
        return bytes(octets)
