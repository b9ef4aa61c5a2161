"""Writers and readers of topics by the type of a sample; the robot's state, which scenes show."""

from dataclasses import replace
from itertools import count
from typing import Generic, TypeVar

from kontur_av.errors import ProtocolError
from kontur_av.media import CaptureStamp
from kontur_av.topics.bus import Lease, Reader, TopicBus
from pipelines.session.mission_messages import MISSION_LEDS_TOPIC, ROBOT_TOPIC
from pipelines.session.topic import Topic
from telepresence.tasks.positions import lights_of
from telepresence.world import StateAt, WorldState, scripted_state
from telepresence.world.state import Lights

T = TypeVar("T")
#: Room for most samples; the topic makes more for a larger one.
_SAMPLE_OCTETS = 2 << 10


class TopicWriter(Generic[T]):
    """Publishes the samples of a topic; a number counts them, also those that nobody reads.

    wake: readers may wait for them. octets: room for a usual sample.
    """

    def __init__(
        self, bus: TopicBus, topic: Topic[T], *, wake: bool = False, octets: int = _SAMPLE_OCTETS
    ) -> None:
        self._writer = bus.writer(topic, max_octets=octets, wake=wake)
        self._topic, self._numbers = topic, count()
        self.has_readers = self._writer.has_readers

    def publish(self, sample: T, now_ns: int, timestamp: int | None = None) -> None:
        """Publish a sample of this instant. timestamp: the 32-bit RTP timestamp of media."""
        stamp = CaptureStamp(now_ns, next(self._numbers), self._topic, rtp_timestamp=timestamp)
        self._writer.publish_octets(self._topic.pack(sample), stamp)

    def publish_read(self, sample: T, now_ns: int, timestamp: int | None = None) -> None:
        """As `publish`, but only count it if the topic has no reader."""
        if self.has_readers():
            self.publish(sample, now_ns, timestamp)
        else:
            next(self._numbers)


class TopicReader(Generic[T]):
    """Reads the samples of a topic. Malformed ones are skipped, and counted in `malformed`.

    depth: unread samples that are kept. opened: False to begin with `open`.
    newest: the newest one that was read, and newest_ns when that was published.
    """

    def __init__(
        self, bus: TopicBus, topic: Topic[T], *, depth: int = 1, opened: bool = True
    ) -> None:
        self._bus, self._topic, self._depth = bus, topic, depth
        self.port: Reader | None = None
        self.newest: T | None = None
        self.newest_ns = self.malformed = 0
        if opened:
            self.open()

    def open(self) -> Reader:
        """Read from now on; return what can be waited for. A second call changes nothing."""
        if self.port is None:
            self.port = self._bus.reader(self._topic, depth=self._depth)
        return self.port

    def close(self) -> None:
        """Leave the topic, so that nobody writes it in vain."""
        if self.port is not None:
            self.port.close()
            self.port = None

    def latest(self) -> T | None:
        """Return the newest sample, if it was not read yet."""
        return self._read(None if self.port is None else self.port.latest())

    def changed(self) -> T | None:
        """As `latest`, if it differs from the one that was read before."""
        before = self.newest
        sample = self.latest()
        return None if sample == before else sample

    def next(self) -> T | None:
        """Return the oldest sample that was not read yet, or None."""
        while self.port is not None and (lease := self.port.next()) is not None:
            if (sample := self._read(lease)) is not None:
                return sample
        return None

    def _read(self, lease: Lease | None) -> T | None:
        if lease is None:
            return None
        with lease:
            try:
                sample = self._topic.unpack(lease.octets())
            except ProtocolError:
                self.malformed += 1
                return None
            self.newest, self.newest_ns = sample, lease.stamp.capture_ns
        return sample


def newest_state(bus: TopicBus, *, leds: bool = False) -> StateAt:
    """Return a function from an instant to the robot's state; without a robot, scripted motion.

    leds: the state has what the LED panel shows, too.
    """
    robot = TopicReader(bus, ROBOT_TOPIC)
    shown = TopicReader(bus, MISSION_LEDS_TOPIC) if leds else None
    lights = Lights()

    def state_at(now_ns: int) -> WorldState:
        nonlocal lights
        robot.latest()
        state = scripted_state(now_ns) if robot.newest is None else robot.newest.at(now_ns)
        if shown is None:
            return state
        if (leds := shown.latest()) is not None:
            lights = lights_of(leds.picture)
        return replace(state, lights=lights)

    return state_at
