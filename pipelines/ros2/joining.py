"""A stream of pictures for those who subscribe in its middle. A core.

A stream has an IDR picture at its beginning and after a loss only, so a later subscriber gets a key
picture that is coded here, as a part of a recording does (`StreamStart`).
"""

from collections.abc import Iterator
from typing import Final, NamedTuple

from kontur_av.clock import NS_PER_S, NS_PER_US
from kontur_av.media import CaptureStamp, VideoCodec
from kontur_av.streams.coded_unit import CodedUnit
from pipelines.recording.own_pictures import MOST_HELD_OCTETS, KeyPictureWanted, StreamStart

#: Units wait no longer for a key picture; then they go out without one.
_PATIENCE_NS: Final = NS_PER_S
#: A second key picture follows the first one after this time, because the way to a subscriber may
#: be there a little later than the subscriber.
_AGAIN_NS: Final = 2 * NS_PER_S
#: A key picture that is coded here comes this long before its unit.
_AHEAD_NS: Final = NS_PER_US


class DatedUnit(NamedTuple):
    """An access unit to publish, captured at `session_ns`."""

    data: bytes
    session_ns: int
    codec: VideoCodec = "h264"


class JoinedStream:
    """The units of one stream. Make the key picture that `next_event` returns.

    Take what `poll_transmit` yields after each call of a `handle_` method.
    """

    def __init__(self) -> None:
        self._start = StreamStart()
        #: The next unit that a decoder can begin with is somebody's first.
        self._begins = True
        self._ready: list[DatedUnit] = []
        self._held: list[DatedUnit] = []
        self._wanted: KeyPictureWanted | None = None
        self._told = True
        self._since_ns = 0
        self._number = 0
        self._again_ns: int | None = None

    def handle_subscriber(self, now_ns: int) -> None:
        """Somebody has subscribed."""
        self._again_ns = now_ns + _AGAIN_NS
        if self._wanted is None:
            self._begins = True

    def handle_unit(
        self, unit: CodedUnit, stamp: CaptureStamp, now_ns: int, *, subscribed: bool
    ) -> None:
        """A unit has come. subscribed: somebody wants it."""
        if self._again_ns is not None and now_ns >= self._again_ns and self._wanted is None:
            self._again_ns = None
            self._begins = True
        begun = self._start.handle_unit(unit, stamp, now_ns, begins=self._begins)
        self._begins = self._begins and begun is None
        key, data = begun or (None, unit.data)
        if not subscribed:
            self._held, self._wanted = [], None
            return
        at_ns = stamp.capture_ns if unit.dated else now_ns
        if isinstance(key, bytes):
            self._ready.append(DatedUnit(key, at_ns - _AHEAD_NS))
        elif key is not None:
            self._number += 1
            self._wanted = KeyPictureWanted(self._number, key, unit.width, unit.height)
            self._told, self._since_ns = False, now_ns
        waits = self._wanted is not None
        (self._held if waits else self._ready).append(DatedUnit(data, at_ns, unit.codec))
        late = now_ns - self._since_ns > _PATIENCE_NS
        if waits and (late or sum(len(one.data) for one in self._held) > MOST_HELD_OCTETS):
            self._release()

    def next_event(self) -> KeyPictureWanted | None:
        """Return the key picture that is wanted, once, or None."""
        if self._told:
            return None
        self._told = True
        return self._wanted

    def handle_key_picture(self, number: int, key: bytes | None) -> None:
        """The key picture of this number is made; None: it could not be."""
        if self._wanted is None or self._wanted.number != number:
            return
        if key is not None:
            self._ready.append(DatedUnit(key, self._held[0].session_ns - _AHEAD_NS))
        self._release()

    def poll_transmit(self) -> Iterator[DatedUnit]:
        """Yield what is to be published now."""
        ready, self._ready = self._ready, []
        yield from ready

    def _release(self) -> None:
        self._ready += self._held
        self._held, self._wanted = [], None
