"""The ways to bring one picture to many processes that `kontur-av bench fanout` compares.

A way is made before its processes are forked. The publisher's process then asks it for the
publishing end, and each reader for a reading end. A picture carries a stamp in its first and in its
last octets: a reader derives its age from it, and checks that both are equal.
"""

import os
import queue
import struct
from contextlib import suppress
from itertools import count
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from kontur_av.clock import NS_PER_S
from kontur_av.media import CaptureStamp, VideoFrame
from kontur_av.topics.bus import TopicBus
from kontur_av.topics.session_files import remove_session

WIDTH, HEIGHT = 640, 480
PICTURE_OCTETS = WIDTH * HEIGHT * 3 // 2
TOPIC = "pictures"

_STAMP = struct.Struct("=qQ")
_LAST = PICTURE_OCTETS - _STAMP.size

#: An object that exposes its octets: an array, bytes, foreign memory.
Octets = Any


class PublishingEnd(Protocol):
    """The end in the publisher's process."""

    def publish(self, now_ns: int, sequence: int) -> None:
        """Stamp the picture, publish it to all readers, and return when it may be overwritten."""

    def close(self) -> None: ...


class ReadingEnd(Protocol):
    """The end in a reader's process."""

    def take(self, timeout_ns: int) -> Octets | None:
        """The octets of the newest picture; None when none came in time."""

    def release(self) -> None:
        """Release the picture that `take` returned."""

    def close(self) -> None: ...


class Way(Protocol):
    """One way to bring pictures to `readers` processes."""

    name: str

    def prepare(self, readers: int, processes: Any) -> None:
        """In the parent, before the forks. processes: a context of multiprocessing."""

    def publishing_end(self) -> PublishingEnd: ...

    def reading_end(self, reader: int) -> ReadingEnd:
        """For reader number `reader`. Call it after the publishing end was made."""

    def clear(self) -> None:
        """In the parent, after all processes have ended: remove files and shared memory."""


def stamp_picture(picture: NDArray[np.uint8], now_ns: int, sequence: int) -> None:
    """Write the stamp to both ends of a flat picture."""
    _STAMP.pack_into(picture.data, 0, now_ns, sequence)
    _STAMP.pack_into(picture.data, _LAST, now_ns, sequence)


def read_stamp(picture: Octets) -> tuple[int, int, bool]:
    """Instant (ns) and sequence of a picture, and whether the stamps at both its ends are equal."""
    first = _STAMP.unpack_from(picture, 0)
    return first[0], first[1], first == _STAMP.unpack_from(picture, _LAST)


def noise() -> NDArray[np.uint8]:
    """A flat picture of random octets, which cannot be compressed."""
    return np.random.default_rng(1).integers(0, 256, PICTURE_OCTETS, np.uint8)


class TopicWay:
    """This project's topics. in_place: the picture is drawn into shared memory, not copied in."""

    _numbers = count()

    def __init__(self, *, in_place: bool) -> None:
        self.name = "topic, in place" if in_place else "topic, copied"
        self._in_place = in_place
        self._session = ""

    def prepare(self, readers: int, processes: Any) -> None:
        self._session = f"fanout-{next(self._numbers)}-{os.getpid()}"

    def publishing_end(self) -> PublishingEnd:
        end = _TopicInPlace if self._in_place else _TopicCopied
        return end(TopicBus(self._session))

    def reading_end(self, reader: int) -> ReadingEnd:
        return _TopicReading(TopicBus(self._session))

    def clear(self) -> None:
        remove_session(self._session)


class _TopicCopied:
    def __init__(self, bus: TopicBus) -> None:
        self._bus = bus
        self._writer = bus.writer(TOPIC, max_octets=PICTURE_OCTETS)
        self._flat = noise()
        self._picture = self._flat.reshape(-1, WIDTH)

    def publish(self, now_ns: int, sequence: int) -> None:
        stamp_picture(self._flat, now_ns, sequence)
        stamp = CaptureStamp(now_ns, sequence, "bench")
        self._writer.publish_video(VideoFrame(self._picture, stamp))

    def close(self) -> None:
        self._bus.close()


class _TopicInPlace:
    def __init__(self, bus: TopicBus) -> None:
        self._bus = bus
        self._writer = bus.writer(TOPIC, max_octets=PICTURE_OCTETS)

    def publish(self, now_ns: int, sequence: int) -> None:
        loan = self._writer.loan_picture(WIDTH, HEIGHT)
        stamp_picture(loan.payload, now_ns, sequence)
        loan.publish(CaptureStamp(now_ns, sequence, "bench"))

    def close(self) -> None:
        self._bus.close()


class _TopicReading:
    def __init__(self, bus: TopicBus) -> None:
        self._bus = bus
        self._reader = bus.reader(TOPIC)
        self._lease: Any = None

    def take(self, timeout_ns: int) -> Octets | None:
        if not self._reader.wait(timeout_ns):
            return None
        self._lease = self._reader.latest()
        return None if self._lease is None else self._lease.payload

    def release(self) -> None:
        self._lease.release()

    def close(self) -> None:
        self._bus.close()


class QueueWay:
    """A `multiprocessing.Queue` for each reader; a full queue drops the newest picture."""

    name = "mp.Queue"
    #: In pictures: a late reader shall not show older ones.
    _DEPTH = 2

    def __init__(self) -> None:
        self._queues: list[Any] = []

    def prepare(self, readers: int, processes: Any) -> None:
        self._queues = [processes.Queue(self._DEPTH) for _ in range(readers)]

    def publishing_end(self) -> PublishingEnd:
        return _QueuePublishing(self._queues)

    def reading_end(self, reader: int) -> ReadingEnd:
        return _QueueReading(self._queues[reader])

    def clear(self) -> None:
        for each in self._queues:
            each.close()
        self._queues = []


class _QueuePublishing:
    def __init__(self, queues: list[Any]) -> None:
        self._queues = queues
        self._picture = noise()

    def publish(self, now_ns: int, sequence: int) -> None:
        stamp_picture(self._picture, now_ns, sequence)
        octets = self._picture.tobytes()
        for each in self._queues:
            with suppress(queue.Full):
                each.put_nowait(octets)

    def close(self) -> None:
        for each in self._queues:
            # Do not wait for readers that no longer fetch.
            each.cancel_join_thread()
            each.close()


class _QueueReading:
    def __init__(self, own: Any) -> None:
        self._own = own

    def take(self, timeout_ns: int) -> Octets | None:
        try:
            return self._own.get(timeout=timeout_ns / NS_PER_S)
        except queue.Empty:
            return None

    def release(self) -> None:
        pass

    def close(self) -> None:
        self._own.close()
