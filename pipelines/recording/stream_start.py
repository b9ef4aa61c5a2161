"""The key picture with which a decoder can begin a part of a recording. A core.

A stream of this project has an IDR picture at its beginning and after a loss only. In between,
refresh waves renew the picture. So where a part begins in the middle of a stream, the recorder puts
a key picture of its own ahead of the stream's first unit:

1. the decoder's picture of the unit before, coded anew, if the units since a beginning are known;
2. else a black one, as after a restart of the recorder. The next wave then makes all right.

The first takes time, so it is made beside the recorder: see `KeyPictureWanted`. Meanwhile the
stream's messages are held.

That unit also gets the stream's parameter sets in front, if it has none, because those of the key
picture differ. Nothing is withheld.
"""

from typing import Final, NamedTuple

from kontur_av.clock import NS_PER_S
from kontur_av.codecs.black_key import black_key
from kontur_av.media import CaptureStamp
from kontur_av.rtp.payload_h264 import parameter_sets
from kontur_av.streams.coded_unit import CodedUnit
from pipelines.media.unit_history import UnitHistory

#: What is decoded at most for a key picture: about 0.2 s of work, at each new part.
_MOST_PIXELS = 50_000_000
#: Messages of a stream wait for a key picture at most so long, and at most so many octets of them.
#: Then a black key picture is written instead, so that none is dropped.
KEY_PATIENCE_NS: Final = 5 * NS_PER_S
MOST_HELD_OCTETS: Final = 1 << 20


class KeyPictureWanted(NamedTuple):
    """Make a key picture of the last picture of these access units, in this size."""

    number: int
    units: tuple[bytes, ...]
    width: int
    height: int


class Begun(NamedTuple):
    """What goes into the file for a unit.

    key: a key picture to write first, or the units whose last picture it is to show; None: none is
    needed.
    """

    key: bytes | tuple[bytes, ...] | None
    data: bytes


class StreamStart:
    """Follows the units of one stream in one channel. A new one begins a part."""

    def __init__(self) -> None:
        self._history = UnitHistory(pictures=False)
        self._sets = b""
        self._fresh = True

    def handle_part(self) -> None:
        """A new part begins: the next unit is its first."""
        self._fresh = True

    def handle_unit(self, unit: CodedUnit, stamp: CaptureStamp, now_ns: int) -> Begun:
        """Return what to write for a unit."""
        self._sets = parameter_sets(unit.data) or unit.parameter_sets or self._sets
        begun = self._begin(unit) if self._fresh else Begun(None, unit.data)
        self._history.handle_unit(unit, stamp, now_ns)
        return begun

    def _begin(self, unit: CodedUnit) -> Begun:
        if unit.key and not unit.damaged:
            self._fresh = False
            return Begun(None, unit.data)
        if unit.refused or not self._sets or not (unit.width and unit.height):
            return Begun(None, unit.data)  # no decoder can begin with it
        self._fresh = False
        data = unit.data if parameter_sets(unit.data) else self._sets + unit.data
        replay = self._history.replay()
        if replay and sum(each.pixels for each in replay) <= _MOST_PIXELS:
            return Begun(tuple(each.data for each in replay), data)
        return Begun(black_key(unit.width, unit.height), data)
