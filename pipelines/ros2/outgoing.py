"""Turns samples of a session's topics into messages of ROS 2; counts what was missed. A core.

A stream has an IDR picture at its beginning and after a loss only, so a later subscriber gets a key
picture of its coder (`JoinedSequence`). All units wait for it: all subscribers get the same.
"""

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Sequence
from typing import Final, NamedTuple

import cv2
import msgspec

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.media import I420, CaptureStamp
from kontur_av.streams.coded_unit import CodedUnit
from pipelines.hand.hand_topics import JoystickStatus
from pipelines.hand.haptic_trace import HapticBlock, rows_of
from pipelines.media.joined_units import JoinedSequence, StreamUnit
from pipelines.mission.tmtc_messages import K2aciArrived, TmtcNews
from pipelines.ros2.publications import (
    CHAT_TOPIC,
    DIAGNOSTICS_TOPIC,
    JOY,
    NUMBER,
    POSE,
    TWIST,
    Publication,
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


class JoinedStream:
    """The units of one stream for its subscribers."""

    def __init__(self) -> None:
        self._sequence = JoinedSequence(most_ns=_TIMEOUT_NS)
        self._again_ns: int | None = None
        self.poll_ask = self._sequence.poll_ask

    def handle_subscriber(self, now_ns: int) -> None:
        self._sequence.waits, self._again_ns = True, now_ns + _AGAIN_NS

    def handle_unit(
        self, unit: CodedUnit, stamp: CaptureStamp, now_ns: int, *, subscribed: bool
    ) -> Sequence[StreamUnit]:
        """Return the units to publish now. subscribed: somebody wants them."""
        sequence = self._sequence
        if self._again_ns is not None and now_ns >= self._again_ns:
            sequence.waits, self._again_ns = True, None
        sequence.waits = sequence.waits and subscribed
        live, begin, before, _ = sequence.handle_unit(unit, stamp, now_ns)
        if before and sequence.waits:
            # They have waited for too long, and who joined still has no picture.
            sequence.waits, self._again_ns = False, now_ns + _AGAIN_NS
        passed = [*before, *begin, *([] if live is None else [live])]
        return passed if subscribed else []


#: Of JPEG, which `image_transport` of ROS 2 decodes everywhere: 640 x 480 pixels have 40 kB.
_JPEG_QUALITY: Final = 80
#: A camera's pictures are coded ten times a second at most: the last part may be early.
_PICTURE_NS: Final = 90 * NS_PER_MS
#: Parts of the report whose figures are diagnostics.
_TOLD: Final = ("streams", "haptic", "link", "processes")


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
        self._streams.pop(source, None)

    def handle_subscriber(self, source: RosSource, now_ns: int) -> None:
        self._stream(source).handle_subscriber(now_ns)

    def poll_ask(self, source: RosSource, now_ns: int) -> bool:
        """Return whether to ask a stream's coder for a key picture now."""
        return self._stream(source).poll_ask(now_ns)

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
        unit = source.topic.unpack(octets) if source.is_coded else None
        if unit is not None and not chosen:
            self._numbers.forget(source.topic)
        elif unit is not None and unit.added:
            pass  # it has the number of another one
        elif missed := self._numbers.handle_sample(source.topic, stamp.sequence):
            self.missed[source.topic] += missed
        if unit is not None:
            stream = self._stream(source)
            for each in stream.handle_unit(unit, stamp, now_ns, subscribed=bool(chosen)):
                at_ns, codec = each.captured_ns, each.unit.codec
                message = self._messages.video(each.data, source.name, at_ns, codec)
                for publication in source.publications:
                    yield Outbound(publication, message)
        elif source.topic.type is HapticBlock:
            yield from self._haptics(source, octets, chosen)
        elif source.topic.type is JoystickStatus:
            status: JoystickStatus = source.topic.unpack(octets)
            self._halves = {"x": status.half_width_m, "y": status.half_height_m}
            self._halves |= {axis.name: axis.half_range for axis in status.axes}
        else:
            news: TmtcNews = source.topic.unpack(octets)
            if isinstance(news, K2aciArrived) and news.kind == Chat.__name__:
                line = f"{news.fields['sender']}: {news.fields['text']}"
                yield Outbound(CHAT_TOPIC, self._messages.text(line))

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
            elif publication.type == NUMBER:
                field = publication.topic.rpartition("/")[2]
                yield Outbound(publication, made.number(rows, field))
            elif publication.type != JOY:
                yield Outbound(publication, made.wrench(rows, source.name))
            elif self._halves:
                yield Outbound(publication, made.joy(rows, source.name, self._halves))
