"""Turns samples of a session's topics into messages of ROS 2; counts what was missed. A core.

A stream has an IDR picture at its beginning and after a loss only, so a later subscriber gets a key
picture that is coded here, as a part of a recording does (`StreamStart`).
"""

from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from typing import Final, NamedTuple

import cv2
import msgspec

from kontur_av.clock import NS_PER_MS, NS_PER_S, NS_PER_US
from kontur_av.media import I420, CaptureStamp, VideoCodec
from kontur_av.streams.coded_unit import CodedUnit
from pipelines.hand.hand_topics import JoystickStatus
from pipelines.hand.haptic_trace import rows_of
from pipelines.mission.tmtc_messages import K2aciArrived, TmtcNews
from pipelines.recording.own_pictures import MOST_HELD_OCTETS, KeyPictureWanted, StreamStart
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
from pipelines.ros2.ros_messages import RosMessages
from pipelines.session.session_metrics import SampleNumbers, SessionNews, nested_values
from telepresence.tmtc.k2aci import Chat

#: Units wait no longer for a key picture; then they go out without one.
_TIMEOUT_NS: Final = NS_PER_S
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
        late = now_ns - self._since_ns > _TIMEOUT_NS
        if waits and (late or sum(len(one.data) for one in self._held) > MOST_HELD_OCTETS):
            # Who joined still has no picture.
            self._again_ns = now_ns + _AGAIN_NS
            self._release()

    def next_event(self) -> KeyPictureWanted | None:
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
        self._numbers = SampleNumbers()
        #: By source of access units.
        self._streams: dict[RosSource, JoinedStream] = {}
        #: By topic of pictures: when the next one is due.
        self._due: dict[str, int] = {}
        #: Half of the range of each axis of the joystick; {} until it is known.
        self._halves: dict[str, float] = {}

    def handle_joined(self, source: RosSource) -> None:
        """The topic is read from now on."""
        self._numbers.forget(source.topic)

    def handle_subscriber(self, source: RosSource, now_ns: int) -> None:
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
        chosen = [publication for publication in source.publications if publication in wanted]
        if source.content is RosContent.UNIT and not chosen:
            self._numbers.forget(source.topic)
        elif missed := self._numbers.handle_sample(source.topic, stamp.sequence):
            self.missed[source.topic] += missed
        if source.content is RosContent.UNIT:
            stream, unit = self._stream(source), CodedUnit.unpack(octets)
            stream.handle_unit(unit, stamp, now_ns, subscribed=bool(chosen))
            yield from self._units(source, stream)
        elif source.content is RosContent.HAPTICS:
            yield from self._haptics(source, octets, chosen)
        elif source.content is RosContent.JOYSTICK:
            status: JoystickStatus = source.topic.unpack(octets)
            self._halves = {"x": status.half_width_m, "y": status.half_height_m}
            self._halves |= {axis.name: axis.half_range for axis in status.axes}
        else:
            news: TmtcNews = source.topic.unpack(octets)
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

    def metrics(self, news: SessionNews, now_ns: int) -> Outbound:
        """Return the diagnostics of what the launcher has told."""
        report = msgspec.json.decode(news.report)
        parts = {
            f"{part} {name}": {
                key: value
                for key, value in nested_values(metrics)
                if value is not None and not isinstance(value, list)
            }
            for part in _TOLD
            for name, metrics in report.get(part, {}).items()
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
