"""Estimates an RTP source's grid, packet rate and usual wait from its packets.

Only the compressor uses this, for its contexts. A wrong estimate costs octets, but never leads to
a wrong header.
"""

from collections import deque
from typing import NamedTuple

from kontur_av.modular import signed
from telepresence.link.compression.rtp_forms import (
    LARGEST_LEAD,
    LARGEST_PERIOD,
    LARGEST_RATE,
    PERIOD_PARTS,
    RATE_PARTS,
    HeaderContext,
    RtpForms,
)
from telepresence.link.flows import Flow

#: Rate assumed until two pictures have been seen.
_ASSUMED_HZ = 30
#: Largest number of grid points in the fit of the line.
_MEMORY = 256
#: Number of latest packets that determine the usual wait.
_WAITS = 64
#: One in this many waits is ignored as too long, and half as many as too short.
_OUTERMOST = 8
#: Two waits that differ by more than this part of a second mean that the source's clock jumped.
_JUMPS_PER_S = 2
#: A block of sound is at most this part of a second: 120 ms (RFC 6716 section 2.1.4).
_STRIDES_PER_S = 8
#: The packets a picture are counted over one to two times this number of pictures.
_PICTURES = 128
#: After this many pictures on a line, trust the line.
_STEADY = 16
#: Pictures needed to know a source that keeps its grid to the tick, and any other source.
_FEW, _MANY = 4, 32


class _Picture(NamedTuple):
    """A picture's number, and the sequence number and the timestamp of its first packet."""

    number: int
    sequence: int
    timestamp: int


class RtpSource:
    """One SSRC, packet by packet.

    The grid is a line through the timestamps of the pictures, fitted by recursive least squares.
    Its memory grows up to `_MEMORY` pictures. At the k-th point the gains of such a filter are
    2(2k - 1) / (k(k + 1)) for the position and 6 / (k(k + 1)) for the slope. A flow with a known
    stride has a given grid, until its blocks have another length.

    index: number of the grid point nearest to the latest packet.
    """

    def __init__(self, flow: Flow, forms: RtpForms, sequence: int, timestamp: int) -> None:
        self._forms = forms
        self._stride = flow.stride_ticks
        self.index = 0
        self._grid_index = 0
        #: Timestamp and sequence number, not wrapped.
        self._timestamp = timestamp
        self._sequence = sequence
        self._grid = float(timestamp)
        self._period = float(self._stride or flow.clock_hz // _ASSUMED_HZ)
        self._points = 1
        # First packets of two pictures; the rate is measured from the older one.
        self._pictures = 0
        self._last_picture = _Picture(0, sequence, timestamp)
        self._marks = [self._last_picture, self._last_picture]
        # Pictures since the fit began, and the largest distance of one from the line.
        self._steady = 0
        self._worst = 0.0
        self._waits: deque[int] = deque(maxlen=_WAITS)
        self._jump = flow.clock_hz // _JUMPS_PER_S
        self._longest_stride = flow.clock_hz // _STRIDES_PER_S
        # The latest advance of a timestamp, and how often in a row it was the same.
        self._step = self._same_steps = 0

    def handle_packet(self, sequence: int, timestamp: int, count: int) -> None:
        """Take the next packet to send, and the frame count at which it starts."""
        self._sequence += signed(sequence - self._sequence, 16)
        step = signed(timestamp - self._timestamp)
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
            self._follow_stride(step)
            self.index = self._grid_index = self.index + round(step / self._stride)
            self._grid = timestamp
            return
        if self._points == 1 and step > 0:
            self._period = float(step)
        periods = round((timestamp - self._grid) / self._period)
        error = timestamp - self._grid - periods * self._period
        self.index = self._grid_index + periods
        self._steady += 1
        self._worst = max(self._worst, abs(error))
        if abs(error) > self._period / 4 or (periods == 0 and step > 0):
            self._break()
            return
        if periods < 1:
            # A picture out of order (it refers to later ones) says nothing about the line.
            return
        self._points = points = min(self._points + 1, _MEMORY)
        scale = points * (points + 1)
        self._grid_index = self.index
        self._grid += periods * self._period + 2 * (2 * points - 1) / scale * error
        self._period += 6 / scale * error / periods

    def _follow_stride(self, step: int) -> None:
        """Take the blocks' length from the packets, if they have another than the flow's."""
        self._same_steps = self._same_steps + 1 if step == self._step else 1
        self._step = step
        if self._same_steps >= _FEW and 0 < step <= self._longest_stride:
            self._stride = step
            self._period = float(step)

    def _break(self) -> None:
        """Restart the fit: a pause, another rate, or a source without a grid."""
        self._steady, self._worst = 0, 0.0
        self._points = 1
        self._grid = float(self._timestamp)
        self._grid_index = self.index

    def _usual_wait(self) -> float:
        """Return the middle of the latest waits without the outermost: starts and stalls."""
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
    ) -> HeaderContext:
        """Return a context of the latest packet."""
        lead = round((self._waits[-1] - self._usual_wait()) / self._forms.lead_ticks)
        period, phase = self._period, round(self._grid) - self._timestamp
        index = self._grid_index
        pictures, sequences, ticks = (
            last - first for last, first in zip(self._last_picture, self._marks[0], strict=True)
        )
        if not self._stride and self._steady < _STEADY <= pictures and ticks > 0:
            # Without a grid, the mean distance still predicts the sequence number.
            period, phase = ticks / pictures, 0
            index = self.index
        rate = 1.0
        if not self._stride and ticks > 0:
            rate = sequences * period / ticks
            # Probably one packet a picture, with some pictures left out: then 1 is exact.
            if 7 / 8 <= rate <= 9 / 8:
                rate = 1.0
        return HeaderContext(
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
            index=index & 3,
            lead=max(-LARGEST_LEAD, min(lead, LARGEST_LEAD)),
        )
