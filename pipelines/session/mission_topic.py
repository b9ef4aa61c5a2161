"""Topics of a mission: one writer or reader of one kind of message."""

from itertools import count
from typing import Generic, TypeVar

from kontur_av.media import CaptureStamp
from kontur_av.topics.bus import Lease, TopicBus
from pipelines.session.mission_messages import (
    MISSION_OCTETS,
    CameraWish,
    ExperimentShown,
    LedsShown,
    Message,
    PanelShown,
    RobotCommand,
    RobotOrder,
    RobotStatus,
    pack,
    unpack,
)

_Kind = TypeVar(
    "_Kind",
    CameraWish,
    RobotOrder,
    RobotCommand,
    RobotStatus,
    PanelShown,
    ExperimentShown,
    LedsShown,
)


class MissionWriter:
    """Publishes messages. wake: readers may wait for them."""

    def __init__(self, bus: TopicBus, topic: str, *, wake: bool = False) -> None:
        self._writer = bus.writer(topic, max_octets=MISSION_OCTETS, wake=wake)
        self._topic, self._numbers = topic, count()

    def publish(self, message: Message, now_ns: int) -> None:
        """Publish a message."""
        stamp = CaptureStamp(now_ns, next(self._numbers), self._topic)
        self._writer.publish_octets(pack(message), stamp)


class MissionReader(Generic[_Kind]):
    """Reads messages. newest: the newest one that was read, and newest_ns when that was sent."""

    def __init__(self, bus: TopicBus, topic: str, kind: type[_Kind], *, depth: int = 1) -> None:
        self._reader = bus.reader(topic, depth=depth)
        self._kind: type[_Kind] = kind
        self.newest: _Kind | None = None
        self.newest_ns = 0

    def latest(self) -> _Kind | None:
        """Return the newest message, if it was not read yet."""
        lease = self._reader.latest()
        return None if lease is None else self._read(lease)

    def next(self) -> _Kind | None:
        """Return the oldest message that was not read yet, or None."""
        lease = self._reader.next()
        return None if lease is None else self._read(lease)

    def _read(self, lease: Lease) -> _Kind:
        with lease:
            self.newest_ns = lease.stamp.capture_ns
            found: _Kind = unpack(self._kind, lease.octets())
        self.newest = found
        return found
