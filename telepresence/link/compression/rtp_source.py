"""What a sender can tell of an RTP source by watching it: its grid, its rate, its usual wait.

Only the compressor uses this. It puts what it finds into contexts; a wrong guess costs octets,
never a wrong header.
"""

from collections import deque
from typing import NamedTuple

from telepresence.link.compression.rtp_forms import (
    LARGEST_LEAD,
    LARGEST_PERIOD,
    LARGEST_RATE,
    PERIOD_PARTS,
    RATE_PARTS,
    Context,
    RtpForms,
    signed32,
)
from telepresence.link.flows import Flow

#: Until two pictures have been seen.
_ASSUMED_HZ = 30
#: How many grid points the line through them is fitted to, at the most.
_MEMORY = 256
#: The usual wait is that of so many packets, the last ones.
_WAITS = 64
#: One in so many of them is left out as too long, and half as many as too short.
_OUTERMOST = 8
#: Waits that differ by more than this part of a second are of a source that has jumped.
_JUMPS_PER_S = 2
#: Packets a picture are counted over one to two times as many pictures.
_PICTURES = 128
#: A line that fits so many pictures was no accident.
_STEADY = 16
#: So many pictures tell all of a source that keeps its grid to the tick, and so many of any other.
_FEW, _MANY = 4, 32


class _Picture(NamedTuple):
    """A picture's number, and the sequence number and the timestamp of its first packet."""

    number: int
    sequence: int
    timestamp: int


class RtpSource:
    """One SSRC, packet by packet.

    Its grid is a straight line through the timestamps of its pictures, fitted by least squares
    with a memory that grows up to `_MEMORY` pictures: the gains of such a filter are
    2(2k - 1) / (k(k + 1)) for the position and 6 / (k(k + 1)) for the slope at the k-th point.
    A flow of known stride has its grid given.

    index: number of the grid point next to the packet seen last.
    """

    def __init__(self, flow: Flow, forms: RtpForms, sequence: int, timestamp: int) -> None:
        self._forms = forms
        self._stride = flow.stride_ticks
        self.index = 0
        #: Timestamps and sequence numbers without their wraps.
        self._timestamp = timestamp
        self._sequence = sequence
        self._grid = float(timestamp)
        self._period = float(self._stride or flow.clock_hz // _ASSUMED_HZ)
        self._points = 1
        # First packets of pictures: the rate is measured from the older one.
        self._pictures = 0
        self._last_picture = _Picture(0, sequence, timestamp)
        self._marks = [self._last_picture, self._last_picture]
        # Pictures since the line was begun, and how far the worst one was beside it.
        self._steady = 0
        self._worst = 0.0
        self._waits: deque[int] = deque(maxlen=_WAITS)
        self._jump = flow.clock_hz // _JUMPS_PER_S

    def handle_packet(self, sequence: int, timestamp: int, count: int) -> None:
        """The next packet that is sent, and the frame count at which it starts."""
        self._sequence += (sequence - self._sequence + 0x8000 & 0xFFFF) - 0x8000
        step = signed32(timestamp - self._timestamp)
        if step:
            self._timestamp += step
            self._handle_picture(step)
        wait = self._forms.slots_in_ticks(count) - self._timestamp
        waits = self._waits
        if waits and not -self._jump < wait - waits[-1] < self._jump:
            waits.clear()
        waits.append(wait)

    def _handle_picture(self, step: int) -> None:
        timestamp = self._timestamp
        self._pictures += 1
        self._last_picture = _Picture(self._pictures, self._sequence, timestamp)
        if self._pictures % _PICTURES == 0:
            self._marks = [self._marks[1], self._last_picture]
        if self._stride:
            self.index += round(step / self._stride)
            self._grid = timestamp
            return
        if self._points == 1 and step > 0:
            self._period = float(step)
        periods = round((timestamp - self._grid) / self._period)
        error = timestamp - self._grid - periods * self._period
        self.index += periods
        self._steady += 1
        self._worst = max(self._worst, abs(error))
        if abs(error) > self._period / 4 or (periods == 0 and step > 0):
            self._break()
            return
        if periods < 1:
            # Out of order (a picture that refers to later ones): no news of the line.
            self.index -= periods
            return
        self._points = points = min(self._points + 1, _MEMORY)
        scale = points * (points + 1)
        self._grid += periods * self._period + 2 * (2 * points - 1) / scale * error
        self._period += 6 / scale * error / periods

    def _break(self) -> None:
        """Not on the grid: a pause, another rate, or a source that has none."""
        self._steady, self._worst = 0, 0.0
        self._points = 1
        self._grid = float(self._timestamp)

    def _usual_wait(self) -> float:
        """The middle of the last waits but the outermost ones: the first picture of a start waits
        for a long time, and so does what follows a stall; neither says anything of the others."""
        ordered = sorted(self._waits)
        if len(ordered) > 1:
            outermost = -(-len(ordered) // _OUTERMOST)
            ordered = ordered[outermost // 2 : -outermost]
        return (ordered[0] + ordered[-1]) / 2

    @property
    def known(self) -> bool:
        """Whether enough was seen for a context that serves for many seconds."""
        exact = self._steady >= _FEW and self._worst <= 1
        return exact or self._pictures >= _MANY or self._stride > 0

    def context(
        self, number: int, count: int, marker: int, payload_type: int, ssrc: int
    ) -> Context:
        """A context of the packet seen last."""
        lead = round((self._waits[-1] - self._usual_wait()) / self._forms.lead_ticks)
        period, phase = self._period, round(self._grid) - self._timestamp
        pictures, sequences, ticks = (
            last - first for last, first in zip(self._last_picture, self._marks[0], strict=True)
        )
        if not self._stride and self._steady < _STEADY <= pictures and ticks > 0:
            # On no grid; the mean distance still tells the sequence number.
            period, phase = ticks / pictures, 0
        rate = 1.0
        if not self._stride and ticks > 0:
            rate = sequences * period / ticks
            # One packet a picture, but for pictures that were left out: exact while none is.
            if 7 / 8 <= rate <= 9 / 8:
                rate = 1.0
        return Context(
            number=number,
            count=count,
            marker=marker,
            payload_type=payload_type,
            sequence=self._sequence & 0xFFFF,
            timestamp=self._timestamp & 0xFFFF_FFFF,
            ssrc=ssrc,
            period=max(1, min(round(period * PERIOD_PARTS), LARGEST_PERIOD)),
            rate=max(0, min(round(rate * RATE_PARTS), LARGEST_RATE)),
            phase=phase if -0x8000 <= phase < 0x8000 else 0,
            index=self.index & 3,
            lead=max(-LARGEST_LEAD, min(lead, LARGEST_LEAD)),
        )
