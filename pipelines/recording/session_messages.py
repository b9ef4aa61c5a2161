"""What becomes of a session's samples, events and figures: messages of its channels. A core.

The recorder writes them into a file; others show them live.
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kontur_av.clock import NS_PER_MS
from kontur_av.media import CaptureStamp
from pipelines.hand.hand_topics import DriverState
from pipelines.hand.haptic_trace import CONTACT, HapticBlock, rows_of
from pipelines.media.joined_units import StreamUnit
from pipelines.recording import recorded_messages as messages
from pipelines.recording.channels import (
    EVENTS,
    LOG_LINES,
    RECEIVED,
    SENT,
    SESSION_METRICS,
    Source,
    parameter_topics,
)
from pipelines.recording.packet_words import PacketWords
from pipelines.session.mission_messages import ExperimentShown, LedsShown, PanelShown
from pipelines.session.topic import OpusPacket, PacketOctets
from pipelines.session.topology.rows import Frames
from telepresence.link.link_metrics import GatewayMetrics
from telepresence.tmtc.pus.dictionary import Dictionary

#: A contact has ended when the tip was free for this long; shorter breaks are the tip's bounces.
_FREE_NS = 50 * NS_PER_MS


class ContactWatch:
    """Tells when a contact begins and ends."""

    def __init__(self) -> None:
        self._touches = False
        self._last_ns = 0

    def handle_rows(self, rows: NDArray[np.void]) -> list[tuple[int, str]]:
        """Return instant (session clock) and words of what rows of a haptic trace show."""
        found: list[tuple[int, str]] = []
        at_ns = rows["time_ns"][(rows["flags"] & CONTACT) != 0]
        for instant in at_ns.tolist() if len(at_ns) else ():
            if self._touches and instant - self._last_ns > _FREE_NS:
                found.append((self._last_ns, "touch ends"))
                self._touches = False
            if not self._touches:
                found.append((instant, "touch begins"))
                self._touches = True
            self._last_ns = instant
        if self._touches and int(rows["time_ns"][-1]) - self._last_ns > _FREE_NS:
            found.append((self._last_ns, "touch ends"))
            self._touches = False
        return found


#: Kinds of events that are warnings in the log.
_WARNINGS = frozenset({"process", "stale", "recorder"})

#: What is told at each change: by type, what makes its message.
_SHOWN: Mapping[Any, Callable[..., messages.Recorded]] = {
    ExperimentShown: messages.RecordedExperiment.of,
    LedsShown: messages.RecordedLeds.of,
    DriverState: messages.RecordedDriver.of,
    PanelShown: messages.RecordedPanel.of,
}

Figure = float | str | bool | None


class Instants(NamedTuple):
    """When a sample was published, and when it is read."""

    published_ns: int
    now_ns: int


class ChannelMessage(NamedTuple):
    """A message of a channel. log_ns: wall time of what it is about."""

    channel: str
    data: bytes
    log_ns: int
    sequence: int
    at: Instants


class SessionMessages:
    """Makes the messages of one reader.

    wall_offset_ns: wall time less the session's clock. dictionary: names what packets say.
    """

    def __init__(self, wall_offset_ns: int, dictionary: Dictionary) -> None:
        self._offset_ns = wall_offset_ns
        self._words = PacketWords(dictionary)
        self._contact = ContactWatch()
        self._events = self._metrics = 0
        #: By topic of what is told at each change: what was told, and how often.
        self._shown: dict[str, messages.Recorded] = {}
        self._changes: Counter[str] = Counter()
        #: The figures that were told.
        self._told: Mapping[str, Figure] = {}

    def of_sample(
        self, source: Source, octets: bytes, stamp: CaptureStamp, at: Instants
    ) -> Sequence[ChannelMessage]:
        """Return what a sample becomes, other than an access unit or a camera's picture."""
        at_ns, kind, number = stamp.capture_ns, source.topic.type, stamp.sequence
        channels = source.channels
        if kind is HapticBlock:
            rows = rows_of(octets)
            if not len(rows):
                return []
            told = [
                messages.pack_haptics(messages.haptic_samples(rows, rows[way]))
                for way in (SENT, RECEIVED)
            ]
            at_ns = int(rows["time_ns"][0])
        elif kind is OpusPacket:
            # A receiver that has no sender report yet cannot date its packets.
            at_ns = stamp.capture_ns or at.published_ns
            told = [
                messages.pack(messages.RecordedSound(wall_ns=at_ns + self._offset_ns, data=octets))
            ]
        elif kind is PacketOctets:
            packet = messages.RecordedPacket(
                session_ns=at_ns, data=octets, what=self._words.of(octets)
            )
            told = [messages.pack(packet)]
            channels = channels[:1]
            named = self._words.values(octets) if len(source.channels) > 1 else None
            if named is not None:
                application, found = named
                topics = parameter_topics((application,), source.topic)
                channels += tuple(topic for topic in topics if topic in source.channels)
                values = messages.RecordedParameters(session_ns=at_ns, values=found)
                told += [messages.pack(values)] * (len(channels) - 1)
        elif kind is GatewayMetrics:
            metrics: GatewayMetrics = source.topic.unpack(octets)
            state = metrics.supervision
            sent = messages.LinkSent.of(metrics.transmit, metrics.radio, state, session_ns=at_ns)
            received = messages.LinkReceived.of(metrics.receive, state, session_ns=at_ns)
            told = [messages.pack(sent), messages.pack(received)]
        elif kind in _SHOWN:
            shown = source.topic.unpack(octets)
            undated = _SHOWN[kind](shown, 0)
            if self._shown.get(source.topic) == undated:
                return []
            self._shown[source.topic] = undated
            self._changes[source.topic] += 1
            number = self._changes[source.topic]
            told = [messages.pack(_SHOWN[kind](shown, at_ns))]
        elif kind == Frames:
            frames = source.topic.unpack(octets)
            if not frames:
                return []
            times, data = zip(*frames, strict=True)
            told = [messages.pack(messages.RecordedFrames(time_ns=times, data=data))]
            at_ns = times[0]
        else:
            raise ValueError(f"{source.topic}: its samples are not octets")
        return _messages(channels, told, at_ns + self._offset_ns, number, at)

    def touches(self, source: Source, octets: bytes) -> Sequence[messages.RecordedEvent]:
        """Return the touches in a sample of the robot's haptics."""
        if source.topic.type is not HapticBlock or source.name != "robot":
            return []
        return [
            messages.RecordedEvent(session_ns=at_ns, number=0, what="touch", text=text)
            for at_ns, text in self._contact.handle_rows(rows_of(octets))
        ]

    def of_unit(self, source: Source, came: StreamUnit, now_ns: int) -> Sequence[ChannelMessage]:
        """Return an access unit and its facts."""
        unit, stamp, at_ns, data = came
        wall_ns = came.captured_ns + self._offset_ns
        picture = messages.RecordedPicture(
            wall_ns=wall_ns, frame_id=source.name, data=data, format=unit.codec
        )
        told = [messages.pack(picture), messages.pack(messages.UnitMetadata.of(unit, stamp))]
        at = Instants(at_ns, now_ns)
        return _messages(source.channels, told, wall_ns, stamp.sequence, at)

    def of_camera(
        self, source: Source, unit: bytes, stamp: CaptureStamp, number: int, now_ns: int
    ) -> ChannelMessage:
        """Return a picture of a camera that was coded. number: of those that were."""
        wall_ns = stamp.capture_ns + self._offset_ns
        picture = messages.RecordedPicture(wall_ns=wall_ns, frame_id=source.name, data=unit)
        at = Instants(now_ns, now_ns)
        return ChannelMessage(source.channels[0], messages.pack(picture), wall_ns, number, at)

    def of_event(self, event: messages.RecordedEvent, now_ns: int) -> Sequence[ChannelMessage]:
        wall_ns = event.session_ns + self._offset_ns
        level = messages.LogLevel.WARNING if event.what in _WARNINGS else messages.LogLevel.INFO
        line = messages.LogLine(wall_ns=wall_ns, level=level, message=event.text, name=event.what)
        self._events += 1
        told, at = [messages.pack(event), messages.pack(line)], Instants(now_ns, now_ns)
        return _messages((EVENTS, LOG_LINES), told, wall_ns, self._events, at)

    def handle_fresh(self) -> None:
        """Who reads the messages from now on has no figures, and nothing of tasks."""
        self._told = {}
        self._shown.clear()

    def of_metrics(
        self, metrics: Mapping[str, Figure], session_ns: int, now_ns: int
    ) -> ChannelMessage:
        """Return those of the session's figures at `session_ns` that have changed."""
        before = self._told
        fresh = {
            name: value
            for name, value in metrics.items()
            if name not in before or before[name] != value
        }
        self._told = {**before, **fresh}
        changed = [messages.RecordedFigure.of(name, value) for name, value in fresh.items()]
        told = messages.RecordedMetrics(session_ns=session_ns, metrics=changed)
        self._metrics += 1
        at, wall_ns = Instants(now_ns, now_ns), session_ns + self._offset_ns
        return ChannelMessage(SESSION_METRICS, messages.pack(told), wall_ns, self._metrics, at)


def _messages(
    channels: Sequence[str], told: Sequence[bytes], log_ns: int, sequence: int, at: Instants
) -> list[ChannelMessage]:
    """One message in each channel."""
    return [
        ChannelMessage(channel, data, log_ns, sequence, at)
        for channel, data in zip(channels, told, strict=True)
    ]
