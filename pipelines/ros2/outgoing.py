"""Turns samples of a session's topics into messages of ROS 2; counts what was missed. A core."""

from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from typing import Final, NamedTuple

import cv2
import msgspec

from kontur_av.clock import NS_PER_MS
from kontur_av.media import I420, CaptureStamp
from kontur_av.streams.coded_unit import CodedUnit
from pipelines.hand.hand_topics import unpack_status
from pipelines.hand.haptic_trace import rows_of
from pipelines.mission.tmtc_messages import K2aciArrived, unpack_news
from pipelines.recording.own_pictures import KeyPictureWanted
from pipelines.ros2.joining import JoinedStream
from pipelines.ros2.messages import RosMessages
from pipelines.ros2.publications import (
    CHAT_TOPIC,
    DIAGNOSTICS_TOPIC,
    JOY,
    POSE,
    TWIST,
    Publication,
    RosContent,
    RosSource,
)
from pipelines.session.figures import MonitoredSession
from telepresence.tmtc.k2aci import Chat

#: Of JPEG, which `image_transport` of ROS 2 decodes everywhere: 640 x 480 pixels have 40 kB.
_JPEG_QUALITY: Final = 80
#: A camera's pictures are coded ten times a second at most: the last part may be early.
_PICTURE_NS: Final = 90 * NS_PER_MS
#: Parts of the report whose figures are diagnostics.
_TOLD: Final = ("streams", "haptics", "link", "processes")


class Outbound(NamedTuple):
    """A message to publish."""

    publication: Publication
    octets: bytes


class OutgoingMessages:
    """The messages that a session publishes.

    missed: samples that were gone before they were read, by topic of the session. Pictures of which
    only some are coded are not among them.
    """

    def __init__(self, messages: RosMessages) -> None:
        self._messages = messages
        self.missed: Counter[str] = Counter()
        self._sequences: dict[str, int] = {}
        #: By source of access units.
        self._streams: dict[RosSource, JoinedStream] = {}
        #: By topic of pictures: when the next one is due.
        self._due: dict[str, int] = {}
        #: Half of the range of each axis of the joystick; {} until it is known.
        self._halves: dict[str, float] = {}

    def handle_joined(self, source: RosSource) -> None:
        """The topic is read from now on."""
        self._sequences.pop(source.topic, None)

    def handle_subscriber(self, source: RosSource, now_ns: int) -> None:
        """Somebody has subscribed to access units."""
        self._stream(source).handle_subscriber(now_ns)

    def due(self, source: RosSource, captured_ns: int) -> bool:
        """Whether to code a picture that was captured then."""
        return captured_ns >= self._due.get(source.topic, 0)

    def picture(self, source: RosSource, picture: I420, stamp: CaptureStamp) -> Iterator[Outbound]:
        """Yield a picture's message. Ask `due` before."""
        self._due[source.topic] = stamp.capture_ns + _PICTURE_NS
        image = cv2.cvtColor(picture, cv2.COLOR_YUV2BGR_I420)
        made, jpeg = cv2.imencode(".jpg", image, (cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY))
        assert made
        for publication in source.publications:
            octets = self._messages.image(jpeg.reshape(-1), source.name, stamp.capture_ns)
            yield Outbound(publication, octets)

    def octets(
        self,
        source: RosSource,
        octets: bytes,
        stamp: CaptureStamp,
        wanted: Collection[Publication],
        now_ns: int,
    ) -> Iterator[Outbound]:
        """Yield the messages of any other sample. wanted: publications that have subscribers."""
        chosen = [one for one in source.publications if one in wanted]
        if source.content is RosContent.UNIT and not chosen:
            self._sequences.pop(source.topic, None)
        else:
            self._count(source, stamp)
        if source.content is RosContent.UNIT:
            stream, unit = self._stream(source), CodedUnit.unpack(octets)
            stream.handle_unit(unit, stamp, now_ns, subscribed=bool(chosen))
            yield from self._units(source, stream)
        elif source.content is RosContent.HAPTICS:
            yield from self._haptics(source, octets, chosen)
        elif source.content is RosContent.JOYSTICK:
            status = unpack_status(octets)
            if status is not None:
                self._halves = {"x": status.half_width_m, "y": status.half_height_m}
                self._halves |= {axis.name: axis.half_range for axis in status.axes}
        else:
            news = unpack_news(octets)
            if isinstance(news, K2aciArrived) and news.kind == Chat.__name__:
                line = f"{news.fields['sender']}: {news.fields['text']}"
                yield Outbound(CHAT_TOPIC, self._messages.text(line))

    def next_event(self) -> tuple[RosSource, KeyPictureWanted] | None:
        """Return a key picture that is wanted for those who subscribed, or None."""
        for source, stream in self._streams.items():
            if (wanted := stream.next_event()) is not None:
                return source, wanted
        return None

    def key_picture(self, source: RosSource, number: int, key: bytes | None) -> Iterator[Outbound]:
        """Yield the messages that waited for a key picture; None: it could not be made."""
        stream = self._stream(source)
        stream.handle_key_picture(number, key)
        yield from self._units(source, stream)

    def figures(self, told: bytes, now_ns: int) -> Outbound:
        """Return the diagnostics of what the launcher has told: a `MonitoredSession`."""
        news = msgspec.json.decode(told, type=MonitoredSession)
        report = msgspec.json.decode(news.report)
        parts = {
            f"{part} {name}": dict(_leaves(figures))
            for part in _TOLD
            for name, figures in report.get(part, {}).items()
        }
        return Outbound(DIAGNOSTICS_TOPIC, self._messages.diagnostics(news.problems, parts, now_ns))

    def _stream(self, source: RosSource) -> JoinedStream:
        return self._streams.setdefault(source, JoinedStream())

    def _units(self, source: RosSource, stream: JoinedStream) -> Iterator[Outbound]:
        for unit in stream.poll_transmit():
            message = self._messages.video(unit.data, source.name, unit.session_ns, unit.codec)
            for publication in source.publications:
                yield Outbound(publication, message)

    def _haptics(
        self, source: RosSource, octets: bytes, chosen: Iterable[Publication]
    ) -> Iterator[Outbound]:
        rows, made = rows_of(octets), self._messages
        if not len(rows):
            return
        for publication in chosen:
            if publication.type == POSE:
                yield Outbound(publication, made.pose(rows, source.name))
            elif publication.type == TWIST:
                yield Outbound(publication, made.twist(rows, source.name))
            elif publication.type != JOY:
                yield Outbound(publication, made.wrench(rows, source.name))
            elif self._halves:
                yield Outbound(publication, made.joy(rows, source.name, self._halves))

    def _count(self, source: RosSource, stamp: CaptureStamp) -> None:
        before = self._sequences.get(source.topic)
        self._sequences[source.topic] = stamp.sequence
        # A smaller number is that of a writer that was started again.
        if before is not None and stamp.sequence > before + 1:
            self.missed[source.topic] += stamp.sequence - before - 1


def _leaves(figures: object, name: str = "") -> Iterator[tuple[str, object]]:
    """Yield the numbers and texts of a part of the report, by their keys joined by dots."""
    if isinstance(figures, dict):
        for key, value in figures.items():
            yield from _leaves(value, f"{name}.{key}" if name else key)
    elif not isinstance(figures, list) and figures is not None:
        yield name, figures
