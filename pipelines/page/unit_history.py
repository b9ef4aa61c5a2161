"""The access units of a stream that a page needs to join it in the middle. A core.

Refresh waves have no key picture at which a decoder of a browser would start. So the units since
the last IDR picture are kept. A page decodes them all and draws only the newest: it then has
exactly the picture that the stream's own receiver has, and no octet of the radio was spent.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from kontur_av.streams.coded_unit import CodedUnit

#: What a page may have to decode before its first picture. 0.4 s or less in Chromium, measured.
MOST_PIXELS = 70_000_000
#: Of the units without an IDR picture before them, so many are kept for a local IDR.
_TAIL = 90


@dataclass(frozen=True, slots=True, kw_only=True)
class HistoryUnit:
    """A unit of the stream with its stamp. capture_ns: None if unknown."""

    unit: CodedUnit
    sequence: int
    capture_ns: int | None
    rtp_timestamp: int | None


class UnitHistory:
    """Keeps the units since the last IDR picture, as long as they are few enough to replay.

    parameter_sets: the newest SPS and PPS of the stream, as Annex B; b"" until there are some.
    """

    def __init__(self, *, most_pixels: int = MOST_PIXELS) -> None:
        self._most_pixels = most_pixels
        self._units: deque[HistoryUnit] = deque()
        #: Whether `_units` begins with an IDR picture and has no gap.
        self._whole = False
        self._pixels = 0
        self._next_sequence: int | None = None
        self.parameter_sets = b""

    @property
    def replay(self) -> Sequence[HistoryUnit] | None:
        """The units for a page that joins now; None if it needs a local IDR, or must wait."""
        return tuple(self._units) if self._whole and self._units else None

    def handle_unit(self, unit: HistoryUnit) -> None:
        """A unit of the stream has come. One that the decoder refused is not kept."""
        gap = self._next_sequence is not None and unit.sequence != self._next_sequence
        self._next_sequence = unit.sequence + 1
        coded = unit.unit
        if coded.refused:
            # The stream's own decoder went on without it, and so does a page's.
            self._whole = self._whole and not gap
            return
        found = parameter_sets_of(coded.data)
        if found:
            self.parameter_sets = found
        if coded.key:
            self._units.clear()
            self._pixels = 0
            self._whole = True
        elif gap:
            self._whole = False
        self._units.append(unit)
        self._pixels += coded.width * coded.height
        if self._pixels > self._most_pixels:
            self._whole = False
        if not self._whole:
            while len(self._units) > _TAIL:
                self._units.popleft()

    def after(self, rtp_timestamp: int) -> Sequence[HistoryUnit] | None:
        """Return the units after the one of this timestamp; None if it is not kept any more."""
        units = list(self._units)
        for index, one in enumerate(units):
            if one.rtp_timestamp == rtp_timestamp:
                return units[index + 1 :]
        return None


def parameter_sets_of(data: bytes) -> bytes:
    """Return the SPS and PPS of an access unit as Annex B; b"" unless it has both.

    NAL unit types 7 and 8 of ITU-T H.264, table 7-1.
    """
    found = {7: b"", 8: b""}
    at = data.find(b"\x00\x00\x01")
    while at >= 0 and at + 3 < len(data):
        kind = data[at + 3] & 0x1F
        if kind in (1, 5):
            break  # slices follow the parameter sets
        following = data.find(b"\x00\x00\x01", at + 3)
        if kind in found:
            end = len(data) if following < 0 else following
            found[kind] = b"\x00\x00\x00\x01" + data[at + 3 : end].rstrip(b"\x00")
        at = following
    return found[7] + found[8] if all(found.values()) else b""
