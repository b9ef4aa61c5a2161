"""The topics of access units, for readers that decode a stream themselves.

They cost nothing while nobody reads. A reader that joins gets a key picture, because a stream
seldom has one:

- of H.264 the newest exact picture is coded anew here, in a thread, and published as `added` with
  the number of its unit. A sender has no decoded picture, so it takes what was filmed. That
  resembles the stream until the next refresh;
- of HEVC no decoder goes on from other pictures. So the stream's own coder is asked for one.
"""

from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from itertools import count

import numpy as np

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.codecs.decoder import DecodedPicture
from kontur_av.media import I420, AccessUnit, CaptureStamp, Quality
from kontur_av.rtp.nal_depacketizer import ReceivedUnit
from kontur_av.rtp.nal_formats import parameter_sets_of
from kontur_av.streams.coded_unit import MOST_UNIT_OCTETS, CodedUnit
from kontur_av.topics.bus import TopicBus
from pipelines.media.key_picture_maker import key_of, may_precede

#: Room for most units; the topic makes more for a larger one.
_USUAL_OCTETS = 16 << 10
#: Key pictures that are made here are this far apart, and readers are looked for this often.
_APART_NS, _LOOK_NS = 250 * NS_PER_MS, 20 * NS_PER_MS
#: A damaged picture is taken if no exact one comes for this time. One that heals the stream refers
#: to an exact one before the damage, which a decoder that begins with a damaged one does not have.
_EXACT_NS = 3 * NS_PER_S
#: A sender's stream is healed by a picture that refers to one of this time before, at most.
_HEALED_NS = 3 * NS_PER_S
#: How long a coder of HEVC is asked for a key picture, and how far apart that begins.
_ASKED_NS, _ASKED_APART_NS = 3 * NS_PER_S, 10 * NS_PER_S


class _CodedTopic:
    """The units of one stream. Call `poll` at each wake-up."""

    def __init__(self, bus: TopicBus, source: str, topic: str) -> None:
        self._source = source
        self._numbers = count()
        self._writer = bus.writer(topic, max_octets=_USUAL_OCTETS)
        self._sets = b""
        self._joins = self._looked_ns = 0
        #: Whether a reader waits for a key picture, and when one was asked for or made.
        self._waiting = False
        self._waiting_ns = 0
        self._key_ns: int | None = None
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="key pictures")
        self._newest: tuple[I420 | DecodedPicture, CodedUnit, CaptureStamp] | None = None
        self._making: tuple[Future[bytes], CodedUnit, CaptureStamp] | None = None

    def poll(self, now_ns: int) -> None:
        """Publish a key picture that is ready, and see who joins while no units come."""
        if self._making is not None and self._making[0].done():
            (made, unit, stamp), self._making = self._making, None
            key = replace(unit, data=made.result(), key=True, damaged=False, added=True)
            self._publish(key, stamp)
        if now_ns - self._looked_ns >= _LOOK_NS:
            self._look(now_ns)
            self._make_key(now_ns)

    def _handle(
        self,
        unit: CodedUnit,
        stamp: CaptureStamp,
        now_ns: int,
        picture: I420 | DecodedPicture | None,
    ) -> bool:
        """Publish a unit. Return whether the coder is to be asked for a key picture.

        picture: what a decoder shows after it, as nearly as it is known; None: it is unknown.
        """
        # Also without a reader, because one that comes later needs them.
        self._sets = parameter_sets_of(unit.data, unit.codec) or self._sets
        unit = replace(unit, parameter_sets=self._sets)
        self._look(now_ns, key=unit.key and not unit.damaged)
        self._publish(unit, stamp)
        if unit.codec == "h264":
            self._newest = self._newest if picture is None else (picture, unit, stamp)
            self._make_key(now_ns)
            return False
        if self._waiting and (self._key_ns is None or now_ns - self._key_ns >= _ASKED_APART_NS):
            self._key_ns = now_ns
        return self._waiting and self._key_ns is not None and now_ns - self._key_ns < _ASKED_NS

    def _look(self, now_ns: int, *, key: bool = False) -> None:
        """See who has joined. key: a key picture is about to be published."""
        self._looked_ns = now_ns
        before, self._joins = self._joins, self._writer.joins()
        waiting = not key and (self._waiting or self._joins > before)
        self._waiting_ns = self._waiting_ns if self._waiting else now_ns
        self._waiting = waiting and self._writer.has_readers()

    def _make_key(self, now_ns: int) -> None:
        soon = self._key_ns is not None and now_ns - self._key_ns < _APART_NS
        if not self._waiting or self._newest is None or self._making is not None or soon:
            return
        picture, unit, stamp = self._newest
        exact = stamp.quality is not Quality.DAMAGED or now_ns - self._waiting_ns >= _EXACT_NS
        if not exact or not may_precede(unit.data, self._sets):
            return
        self._waiting, self._key_ns = False, now_ns
        kept = picture.copy() if isinstance(picture, np.ndarray) else picture
        made = self._thread.submit(key_of, kept, unit.width, unit.height, self._sets)
        self._making = made, unit, stamp

    def _publish(self, unit: CodedUnit, stamp: CaptureStamp) -> None:
        if len(unit.data) <= MOST_UNIT_OCTETS and self._writer.has_readers():
            self._writer.publish_octets(unit.pack(), stamp)


class ReceivedTopic(_CodedTopic):
    """The units that the receiver of a stream got, and its decoder took."""

    _picture: DecodedPicture | None = None
    _shown: CaptureStamp | None = None

    def handle_picture(self, picture: DecodedPicture, shown: CaptureStamp | None) -> None:
        """The decoder returned a picture. shown: its stamp; None: it is not shown."""
        self._picture, self._shown = picture, shown

    def handle_unit(self, unit: ReceivedUnit, capture_ns: int | None) -> bool:
        """The decoder has taken a unit, and `handle_picture` was called for its picture.

        capture_ns: when it was captured; None: not known yet. Return whether the sender is to be
        asked for a key picture.
        """
        picture, shown = self._picture, self._shown
        self._picture = self._shown = None
        coded, stamp = received_unit(
            unit,
            size=None if picture is None else (picture.width, picture.height),
            shown=shown,
            capture_ns=capture_ns,
            sequence=next(self._numbers),
            source=self._source,
        )
        return self._handle(coded, stamp, unit.received_ns, None if coded.refused else picture)


class SentTopic(_CodedTopic):
    """The units that the sender of a stream made."""

    def handle_unit(
        self, unit: AccessUnit, size: tuple[int, int], picture: I420 | DecodedPicture | None
    ) -> bool:
        """A unit was encoded in `size`, and its packets leave.

        picture: of which it was made. It may change after this call.
        Return whether the encoder is to be asked for a key picture.
        """
        coded = CodedUnit(
            data=unit.data, key=unit.keyframe, width=size[0], height=size[1], codec=unit.codec
        )
        now_ns = unit.stamp.capture_ns
        stamp = CaptureStamp(now_ns, next(self._numbers), self._source)
        joined_ns = self._key_ns
        wanted = self._handle(coded, stamp, now_ns, picture)
        self._newest = None
        # It may refer to pictures from before the key picture of those who joined.
        heals = unit.heals and joined_ns is not None and now_ns - joined_ns < _HEALED_NS
        return wanted or heals


def received_unit(
    unit: ReceivedUnit,
    *,
    size: tuple[int, int] | None,
    shown: CaptureStamp | None,
    capture_ns: int | None,
    sequence: int,
    source: str,
) -> tuple[CodedUnit, CaptureStamp]:
    """Return a received access unit and its stamp.

    size: width and height of its picture in pixels; None: the decoder returned none.
    shown: the stamp with which the picture was published; None: it was not.
    capture_ns: when it was captured; None: not known yet.
    sequence: number of the unit. source: the stream.
    """
    # A dated picture that is not published is too large.
    refused = size is None or (shown is None and capture_ns is not None)
    quality = Quality.DAMAGED if unit.damaged else Quality.FRESH
    width, height = (0, 0) if size is None or refused else size
    coded = CodedUnit(
        data=unit.data,
        key=unit.keyframe,
        damaged=unit.damaged,
        refused=refused,
        dated=capture_ns is not None,
        width=width,
        height=height,
        codec=unit.codec,
    )
    return coded, CaptureStamp(
        capture_ns or 0,
        sequence,
        source,
        quality if shown is None else shown.quality,
        unit.timestamp,
    )
