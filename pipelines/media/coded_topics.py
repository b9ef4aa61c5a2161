"""The topics for readers that decode a stream themselves. They cost nothing while nobody reads."""

from itertools import count

from kontur_av.clock import NS_PER_S
from kontur_av.codecs.decoder import DecodedPicture
from kontur_av.media import AccessUnit, CaptureStamp, Quality, VideoCodec
from kontur_av.rtp.nal_formats import parameter_sets_of
from kontur_av.rtp.nal_payload import ReceivedUnit
from kontur_av.streams.coded_unit import MOST_UNIT_OCTETS, CodedUnit
from kontur_av.topics.bus import TopicBus, Writer
from pipelines.session.setup.table import VideoStream

#: Room for most units; the topic makes more for a larger one.
_USUAL_OCTETS = 16 << 10


#: How long a key picture is asked for, and how far apart that begins.
_ASKED_NS, _APART_NS = 3 * NS_PER_S, 10 * NS_PER_S


class _NewReaders:
    """Notices who begins to read HEVC, and needs a key picture of the stream itself."""

    def __init__(self, writer: Writer) -> None:
        self._writer = writer
        self._joins = 0
        self._waiting = False
        self._asked_ns: int | None = None

    def handle_unit(self, codec: VideoCodec, now_ns: int, *, key: bool) -> bool:
        """A unit is to be published; return whether to ask for a key picture."""
        before, self._joins = self._joins, self._writer.joins()
        if key or codec == "h264" or not self._writer.has_readers():
            self._waiting = False
            return False
        self._waiting |= self._joins > before
        if self._waiting and (self._asked_ns is None or now_ns - self._asked_ns >= _APART_NS):
            self._asked_ns = now_ns
        if self._asked_ns is None or now_ns - self._asked_ns >= _ASKED_NS:
            return False
        return self._waiting


class ReceivedTopics:
    """What a stream's receiver got and decoded: the topics `coded` and `decoded`."""

    def __init__(self, bus: TopicBus, stream: VideoStream, *, coded: str, decoded: str) -> None:
        self._source = stream.name
        self._numbers = count()
        self._coded = bus.writer(coded, max_octets=_USUAL_OCTETS)
        self._decoded = bus.writer(decoded, max_octets=stream.width * stream.height * 3 // 2)
        self._new_readers = _NewReaders(self._coded)
        self._sets = b""
        self._size: tuple[int, int] | None = None
        self._shown: CaptureStamp | None = None

    def handle_picture(self, picture: DecodedPicture, shown: CaptureStamp | None) -> None:
        """The decoder returned a picture. shown: its stamp; None: it is not shown."""
        self._size, self._shown = (picture.width, picture.height), shown
        if shown is not None and self._decoded.has_readers():
            loan = self._decoded.loan_picture(picture.width, picture.height)
            picture.copy_to(loan.picture)
            loan.publish(shown)

    def handle_unit(self, unit: ReceivedUnit, capture_ns: int | None) -> bool:
        """The decoder has taken a unit, and `handle_picture` was called for its picture.

        capture_ns: when it was captured; None: not known yet. Return whether a reader needs a key
        picture.
        """
        key = unit.keyframe and not unit.damaged
        wanted = self._new_readers.handle_unit(unit.codec, unit.received_ns, key=key)
        number, size, shown = next(self._numbers), self._size, self._shown
        self._size = self._shown = None
        # Also without a reader, because one that comes later needs them.
        self._sets = parameter_sets_of(unit.data, unit.codec) or self._sets
        if self._coded.has_readers():
            coded, stamp = received_unit(
                unit,
                size=size,
                shown=shown,
                capture_ns=capture_ns,
                sequence=number,
                source=self._source,
                parameter_sets=self._sets,
            )
            _publish(self._coded, coded, stamp)
        return wanted


class SentTopic:
    """The access units that the sender of the stream `name` made."""

    def __init__(self, bus: TopicBus, name: str, topic: str) -> None:
        self._source = name
        self._numbers = count()
        self._writer = bus.writer(topic, max_octets=_USUAL_OCTETS)
        self._new_readers = _NewReaders(self._writer)
        self._sets = b""

    def handle_unit(self, unit: AccessUnit, size: tuple[int, int]) -> bool:
        """A unit was encoded in `size`, and its packets leave.

        Return whether a reader needs a key picture.
        """
        now_ns = unit.stamp.capture_ns
        wanted = self._new_readers.handle_unit(unit.codec, now_ns, key=unit.keyframe)
        number = next(self._numbers)
        # Also without a reader, because one that comes later needs them.
        self._sets = parameter_sets_of(unit.data, unit.codec) or self._sets
        if self._writer.has_readers():
            coded = CodedUnit(
                data=unit.data,
                key=unit.keyframe,
                width=size[0],
                height=size[1],
                parameter_sets=self._sets,
                codec=unit.codec,
            )
            _publish(self._writer, coded, CaptureStamp(now_ns, number, self._source))
        return wanted


def _publish(writer: Writer, coded: CodedUnit, stamp: CaptureStamp) -> None:
    if len(coded.data) <= MOST_UNIT_OCTETS:
        writer.publish_octets(coded.pack(), stamp)


def received_unit(
    unit: ReceivedUnit,
    *,
    size: tuple[int, int] | None,
    shown: CaptureStamp | None,
    capture_ns: int | None,
    sequence: int,
    source: str,
    parameter_sets: bytes,
) -> tuple[CodedUnit, CaptureStamp]:
    """Return a received access unit and its stamp.

    size: width and height of its picture in pixels; None: the decoder returned none.
    shown: the stamp with which the picture was published; None: it was not.
    capture_ns: when it was captured; None: not known yet.
    sequence: number of the unit. source: the stream. parameter_sets: the newest of the stream.
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
        parameter_sets=parameter_sets,
        codec=unit.codec,
    )
    return coded, CaptureStamp(
        capture_ns or 0,
        sequence,
        source,
        quality if shown is None else shown.quality,
        unit.timestamp,
    )
