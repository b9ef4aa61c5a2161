"""Writers and readers of topics with one kind of sample; the robot's state, which scenes show."""

import struct
from collections.abc import Callable
from dataclasses import replace
from itertools import count
from typing import Generic

from kontur_av.media import CaptureStamp
from kontur_av.topics.bus import Lease, TopicBus
from pipelines.session.mission_messages import (
    MISSION_OCTETS,
    LedsShown,
    Message,
    MessageT,
    pack,
    unpack,
)
from pipelines.session.topology import MISSION_LEDS_TOPIC, ROBOT_TOPIC, TRAINER_TOPIC
from pipelines.session.training import Exercises
from telepresence.tasks.positions import lights_of
from telepresence.world import StateAt, WorldState, scripted_state
from telepresence.world.state import Lights

#: Room for most samples; the topic makes more for a larger one.
_SAMPLE_OCTETS = 2 << 10


class NumberedTopic:
    """Publishes samples; a number counts them. wake: readers may wait for them."""

    def __init__(self, bus: TopicBus, topic: str, *, max_octets: int, wake: bool = False) -> None:
        self._writer = bus.writer(topic, max_octets=max_octets, wake=wake)
        self._topic, self._numbers = topic, count()
        self.has_readers = self._writer.has_readers

    def publish_octets(self, octets: bytes, now_ns: int) -> None:
        self._writer.publish_octets(octets, CaptureStamp(now_ns, next(self._numbers), self._topic))


class SampleTopic:
    """A number counts the samples, also those that nobody reads."""

    def __init__(self, bus: TopicBus, topic: str) -> None:
        self._source, self._numbers = topic, count()
        self._writer = bus.writer(topic, max_octets=_SAMPLE_OCTETS)

    def handle_sample(self, octets: bytes, capture_ns: int, timestamp: int | None = None) -> None:
        """Publish a sample of this instant. timestamp: the 32-bit RTP timestamp of media."""
        number = next(self._numbers)
        if self._writer.has_readers():
            stamp = CaptureStamp(capture_ns, number, self._source, rtp_timestamp=timestamp)
            self._writer.publish_octets(octets, stamp)


class MissionWriter(NumberedTopic):
    """Publishes messages. wake: readers may wait for them."""

    def __init__(self, bus: TopicBus, topic: str, *, wake: bool = False) -> None:
        super().__init__(bus, topic, max_octets=MISSION_OCTETS, wake=wake)

    def publish(self, message: Message, now_ns: int) -> None:
        self.publish_octets(pack(message), now_ns)


class MissionReader(Generic[MessageT]):
    """Reads messages. newest: the newest one that was read, and newest_ns when that was sent."""

    def __init__(self, bus: TopicBus, topic: str, kind: type[MessageT], *, depth: int = 1) -> None:
        self._reader = bus.reader(topic, depth=depth)
        self._kind: type[MessageT] = kind
        self.newest: MessageT | None = None
        self.newest_ns = 0

    def latest(self) -> MessageT | None:
        """Return the newest message, if it was not read yet."""
        lease = self._reader.latest()
        return None if lease is None else self._read(lease)

    def next(self) -> MessageT | None:
        """Return the oldest message that was not read yet, or None."""
        lease = self._reader.next()
        return None if lease is None else self._read(lease)

    def _read(self, lease: Lease) -> MessageT:
        with lease:
            self.newest_ns = lease.stamp.capture_ns
            found: MessageT = unpack(self._kind, lease.octets())
        self.newest = found
        return found


def new_exercises(bus: TopicBus) -> Callable[[], Exercises | None]:
    """Return a function that returns the exercises after each change of them, else None."""
    reader = bus.reader(TRAINER_TOPIC)
    known = Exercises()

    def take() -> Exercises | None:
        nonlocal known
        octets = reader.latest_octets()
        if octets is None or (told := Exercises.unpack(octets)) == known:
            return None
        known = told
        return told

    return take


#: Instant, x, y (m), force (N), contact, instants at which this contact and the newest one began,
#: and whether the hand holds a ball.
_LAYOUT = struct.Struct("=qddd?qq?")
STATE_OCTETS = _LAYOUT.size
#: No contact yet.
_NEVER_NS = -(1 << 63)


def pack_state(state: WorldState) -> bytes:
    """Pack a state; a contact without a beginning begins now."""
    since_ns = state.time_ns if state.contact_since_ns is None else state.contact_since_ns
    touched_ns = state.touched_ns
    if touched_ns is None:
        touched_ns = since_ns if state.contact else _NEVER_NS
    place = state.x_m, state.y_m, state.force_n, state.contact
    return _LAYOUT.pack(state.time_ns, *place, since_ns, touched_ns, state.holds)


def unpack_state(data: bytes) -> WorldState:
    time_ns, x_m, y_m, force_n, contact, since_ns, touched_ns, holds = _LAYOUT.unpack(data)
    return WorldState(
        time_ns,
        x_m,
        y_m,
        force_n,
        contact,
        since_ns if contact else None,
        None if touched_ns == _NEVER_NS else touched_ns,
        holds=holds,
    )


def newest_state(bus: TopicBus, *, leds: bool = False) -> StateAt:
    """Return a function from an instant to the robot's state; without a robot, scripted motion.

    leds: the state has what the LED panel shows, too.
    """
    reader = bus.reader(ROBOT_TOPIC)
    shown = bus.reader(MISSION_LEDS_TOPIC) if leds else None
    known: WorldState | None = None
    lights = Lights()

    def state_at(now_ns: int) -> WorldState:
        nonlocal known, lights
        if (octets := reader.latest_octets()) is not None:
            known = unpack_state(octets)
        state = scripted_state(now_ns) if known is None else known.at(now_ns)
        if shown is None:
            return state
        if (octets := shown.latest_octets()) is not None:
            lights = lights_of(unpack(LedsShown, octets).picture)
        return replace(state, lights=lights)

    return state_at
