"""What a sender can tell of an RTP source by watching it: its grid, its rate, its usual wait.

Only the compressor uses this. It puts what it finds into contexts; a wrong guess costs octets,
never a wrong header.
"""

from telepresence.link.flows import Flow
from telepresence.link.rtp_forms import (
    LARGEST_LEAD,
    LARGEST_PERIOD,
    LARGEST_RATE,
    PERIOD_PARTS,
    RATE_PARTS,
    Context,
    RtpForms,
    signed32,
)

#: Until two pictures have been seen.
_ASSUMED_HZ = 30
#: How many grid points the line through them is fitted to, at the most.
_MEMORY = 256
#: Waits are looked back upon for one to two times as many packets.
_WAITS = 64
#: Waits that differ by more than this part of a second are of a source that has jumped.
_JUMPS_PER_S = 2
#: Packets a picture are counted over one to two times as many pictures.
_PICTURES = 64


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
        self._marks = [(sequence, timestamp), (sequence, timestamp)]
        self._picture_sequence = sequence
        self._pictures = 0
        self._wait = 0
        self._waits = 0
        self._least = self._most = self._older_least = self._older_most = 1 << 63
        self._jump = flow.clock_hz // _JUMPS_PER_S

    def handle_packet(self, sequence: int, timestamp: int, count: int) -> None:
        """The next packet that is sent, and the frame count at which it starts."""
        self._sequence += (sequence - self._sequence + 0x8000 & 0xFFFF) - 0x8000
        step = signed32(timestamp - self._timestamp)
        if step:
            self._timestamp += step
            self._handle_picture(step)
        wait = self._forms.slots_in_ticks(count) - self._timestamp
        fresh = not self._least - self._jump < wait < self._most + self._jump
        if fresh:
            self._waits = 0
        if self._waits % _WAITS == 0:
            self._older_least = wait if fresh else self._least
            self._older_most = wait if fresh else self._most
            self._least = self._most = wait
        elif wait < self._least:
            self._least = wait
        elif wait > self._most:
            self._most = wait
        self._waits += 1
        self._wait = wait

    def _handle_picture(self, step: int) -> None:
        timestamp = self._timestamp
        self._picture_sequence = self._sequence
        self._pictures += 1
        if self._pictures % _PICTURES == 0:
            self._marks = [self._marks[1], (self._sequence, timestamp)]
        if self._stride:
            self.index += round(step / self._stride)
            self._grid = timestamp
            return
        if self._points == 1 and step > 0:
            self._period = float(step)
        periods = round((timestamp - self._grid) / self._period)
        error = timestamp - self._grid - periods * self._period
        self.index += periods
        if abs(error) > self._period / 4 or (periods == 0 and step > 0):
            # Not on the grid: a pause, another rate, or none at all. The next point starts anew.
            self._points = 1
            self._grid = timestamp
            return
        if periods < 1:
            # Out of order (a picture that refers to later ones): no news of the line.
            self.index -= periods
            return
        self._points = points = min(self._points + 1, _MEMORY)
        scale = points * (points + 1)
        self._grid += periods * self._period + 2 * (2 * points - 1) / scale * error
        self._period += 6 / scale * error / periods

    def context(
        self, number: int, count: int, marker: int, payload_type: int, ssrc: int
    ) -> Context:
        """A context of the packet seen last."""
        low = min(self._least, self._older_least)
        high = max(self._most, self._older_most)
        lead = round((self._wait - (low + high) / 2) / self._forms.lead_ticks)
        phase = round(self._grid) - self._timestamp
        return Context(
            number=number,
            count=count,
            marker=marker,
            payload_type=payload_type,
            sequence=self._sequence & 0xFFFF,
            timestamp=self._timestamp & 0xFFFF_FFFF,
            ssrc=ssrc,
            period=max(1, min(round(self._period * PERIOD_PARTS), LARGEST_PERIOD)),
            rate=self._rate(),
            phase=phase if -0x8000 <= phase < 0x8000 else 0,
            index=self.index & 3,
            lead=max(-LARGEST_LEAD, min(lead, LARGEST_LEAD)),
        )

    def _rate(self) -> int:
        """Packets a period, in sixteenths."""
        if self._stride:
            return RATE_PARTS
        (sequence, timestamp), _ = self._marks
        ticks = self._timestamp - timestamp
        if ticks <= 0:
            return RATE_PARTS
        rate = (self._picture_sequence - sequence) * self._period / ticks
        # One packet a picture, but for pictures that were left out: exact as long as none is.
        if 7 / 8 <= rate <= 9 / 8:
            return RATE_PARTS
        return max(0, min(round(rate * RATE_PARTS), LARGEST_RATE))
