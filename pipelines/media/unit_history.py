"""The access units of a stream that a decoder needs to begin now.

A browser's decoder begins with an IDR picture only, and a stream seldom has one. So a page that
joins is sent all units since a point from which they decode to the same pictures as the live ones:

1. an IDR picture of the stream; or
2. a refresh wave that was completed, behind a black picture: the wave renews all of it; or
3. a picture of the live decoder, coded anew, with the units that came after it. It is nearly exact
   at once, and exact after the next wave. It is taken when neither 1 nor 2 is here, as after a
   restart of this process, or when either would take a browser too long to decode.
   A sender has no such picture: there what was filmed for a unit is coded. It resembles the stream
   until the next wave, so it is taken only when neither 1 nor 2 is here.
"""

from collections import deque
from typing import NamedTuple

from kontur_av.clock import NS_PER_S, NS_PER_US
from kontur_av.codecs.black_key import black_key
from kontur_av.codecs.healing import recovery_pictures
from kontur_av.media import CaptureStamp, Quality, VideoCodec
from kontur_av.rtp.nal_formats import parameter_sets_of
from kontur_av.streams.coded_unit import CodedUnit
from pipelines.session.page_messages import UNKNOWN_US

#: What a page may have to decode before its first picture: 0.4 s or less in Chromium, measured.
MOST_PIXELS = 70_000_000
#: Longer histories are given up.
_MOST_NS = 60 * NS_PER_S
_MOST_OCTETS = 4 << 20
#: Units that are kept without a point from which they can be decoded, to wait for one.
_KEPT = 64


class KeptUnit(NamedTuple):
    """An access unit of the history. capture_us: `UNKNOWN_US` if not known."""

    data: bytes
    pixels: int
    key: bool
    damaged: bool
    sequence: int
    capture_us: int
    rtp_timestamp: int | None
    received_ns: int


class UnitHistory:
    """The units of one stream, from a point at which a decoder can begin.

    Of the newest wave it knows where it began and how many units are left of it. Without a
    beginning, the units since the newest wave are kept, and at least 64.

    pictures: the pictures of the live decoder can be had. filmed: what was filmed can be had.
    most_pixels: of a replay, then. Those of
    less than half of it are not exchanged for one that begins with a wave.
    """

    def __init__(
        self, *, pictures: bool, filmed: bool = False, most_pixels: int = MOST_PIXELS
    ) -> None:
        self._pictures, self._filmed = pictures, filmed
        self._most_pixels = most_pixels
        self._units: deque[KeptUnit] = deque()
        self._octets = self._pixels = 0
        #: What comes before the units: nothing if they begin with an IDR picture.
        self._ahead: KeptUnit | None = None
        self._whole = False
        self._next_sequence: int | None = None
        self._sets = b""
        self._codec: VideoCodec = "h264"
        self._size = (0, 0)
        #: The running wave: number of its first unit, and how many units are left of it.
        self._wave: tuple[int, int] | None = None

    @property
    def needs_picture(self) -> bool:
        """Whether a page that joins needs a picture for `handle_picture`."""
        lacks = not self._whole or self._pixels > self._most_pixels
        return self._pictures and lacks and self._continues

    @property
    def needs_filmed(self) -> bool:
        """Whether a page that joins needs what was filmed, for `handle_filmed`."""
        return self._filmed and not self._whole and self._continues

    @property
    def _continues(self) -> bool:
        """Whether a decoder can go on from a picture that was coded here."""
        return bool(self._units) and bool(self._sets)

    def handle_unit(self, unit: CodedUnit, stamp: CaptureStamp, now_ns: int) -> KeptUnit | None:
        """A unit has come; return it as it goes to pages, or None if it must not.

        A decoder may close on a unit that ours refused, so it is withheld.
        """
        if stamp.sequence != self._next_sequence:
            self._clear()
        self._next_sequence = stamp.sequence + 1
        if unit.refused:
            self._wave = None
            return None
        data, sets = unit.data, parameter_sets_of(unit.data, unit.codec)
        if self._whole and not self._units and not unit.key and not sets:
            # The first one behind a picture that was coded here: see `_begin`.
            data = self._sets + data
        kept = KeptUnit(
            data=data,
            pixels=unit.width * unit.height,
            key=unit.key,
            damaged=stamp.quality is Quality.DAMAGED or unit.damaged,
            sequence=stamp.sequence,
            capture_us=stamp.capture_ns // NS_PER_US if unit.dated else UNKNOWN_US,
            rtp_timestamp=stamp.rtp_timestamp,
            received_ns=now_ns,
        )
        self._codec = unit.codec
        self._sets = sets or unit.parameter_sets or self._sets
        if unit.key and not unit.damaged:
            self._clear()
            self._whole = True
        self._size = unit.width, unit.height
        self._units.append(kept)
        self._octets += len(kept.data)
        self._pixels += kept.pixels
        self._follow_wave(unit, kept)
        self._trim(now_ns)
        return kept

    def replay(self) -> list[KeptUnit] | None:
        """Return the units with which a decoder can begin, or None if a page must wait for them."""
        if not self._whole or self.needs_picture:
            return None
        return [*([] if self._ahead is None else [self._ahead]), *self._units]

    def handle_picture(self, key: bytes, rtp_timestamp: int) -> bool:
        """Begin with `key`, the live decoder's picture of this unit, coded anew.

        Return False if that unit is not among those that are kept.
        """
        numbers = [unit.sequence for unit in self._units if unit.rtp_timestamp == rtp_timestamp]
        if not self.needs_picture or not numbers:
            return False
        self._replace(numbers[-1], key)
        return True

    def handle_filmed(self, key: bytes, sequence: int) -> bool:
        """Begin with `key`: what was filmed for the unit of this number, coded in its size.

        Return False if that unit is not among those that are kept.
        """
        known = any(unit.sequence == sequence for unit in self._units)
        if not self.needs_filmed or not known:
            return False
        self._replace(sequence, key)
        return True

    def _replace(self, sequence: int, key: bytes) -> None:
        """Begin with `key` in the place of the unit of this number."""
        picture = next(unit for unit in self._units if unit.sequence == sequence)
        self._drop_before(sequence + 1)
        self._begin(picture._replace(data=key, key=True))

    def _begin(self, ahead: KeptUnit) -> None:
        """Begin with `ahead`, which has parameter sets of its own; the next unit has the stream's.

        They are not sent alone: browsers do not take them for an access unit, and close their
        decoder.
        """
        self._ahead, self._whole = ahead, True
        if self._units and not parameter_sets_of(self._units[0].data, self._codec):
            first = self._units.popleft()
            self._units.appendleft(first._replace(data=self._sets + first.data))
            self._octets += len(self._sets)

    def _follow_wave(self, unit: CodedUnit, kept: KeptUnit) -> None:
        if unit.damaged:
            self._wave = None
            return
        if self._wave is not None:
            first, left = self._wave
            self._wave = (first, left - 1) if left > 1 else None
            if left == 1 and not kept.damaged:
                self._handle_wave(first)
        pictures = recovery_pictures(unit.data, unit.codec)
        if pictures:
            self._wave = kept.sequence, pictures

    def _handle_wave(self, first: int) -> None:
        """The wave that began with the unit `first` is complete."""
        if (self._whole and self._pixels <= self._most_pixels // 2) or not all(self._size):
            return
        if self._codec != "h264":
            return  # no black picture of H.264 goes ahead of HEVC
        self._drop_before(first)
        wave = self._units[0]
        self._begin(wave._replace(data=black_key(*self._size), key=True, capture_us=UNKNOWN_US))

    def _trim(self, now_ns: int) -> None:
        units = self._units
        if self._octets > _MOST_OCTETS or units[0].received_ns < now_ns - _MOST_NS:
            self._ahead, self._whole = None, False
        if self._whole:
            return
        needed = units[-1].sequence + 1 if self._wave is None else self._wave[0]
        while len(units) > _KEPT and units[0].sequence < needed:
            self._drop_oldest()
        while units and (self._octets > _MOST_OCTETS or units[0].received_ns < now_ns - _MOST_NS):
            self._drop_oldest()
            self._wave = None

    def _drop_before(self, sequence: int) -> None:
        while self._units and self._units[0].sequence < sequence:
            self._drop_oldest()

    def _drop_oldest(self) -> None:
        oldest = self._units.popleft()
        self._octets -= len(oldest.data)
        self._pixels -= oldest.pixels

    def _clear(self) -> None:
        self._units.clear()
        self._octets = self._pixels = 0
        self._ahead, self._whole, self._wave = None, False, None
