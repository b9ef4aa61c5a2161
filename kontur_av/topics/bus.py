"""Topics in shared memory: publish once, any number of readers, nobody waits for anybody.

This is a thin layer over iceoryx2 (https://iceoryx.io). A reader sees the writer's octets without a
copy. A slow reader loses the oldest samples. A killed process affects no other; its resources are
freed when the next process joins. The topic's notifier wakes all sleeping readers with one system
call of the writer; iceoryx2's own events need one for each reader.

Where iceoryx2 is not installed, topics are files (`kontur_av.topics.file_node`), at two copies a
sample. `KONTUR_AV_TOPICS=files` chooses them elsewhere.

Use::

    with TopicBus("my-session") as bus:
        writer = bus.writer("camera", max_octets=640 * 480 * 3 // 2)
        loan = writer.loan_picture(640, 480)
        loan.picture[:] = 128
        loan.publish(CaptureStamp(now_ns, 0, "camera"))

        reader = bus.reader("camera")
        if reader.wait(100_000_000) and (lease := reader.latest()):
            with lease:
                show(lease.video())
"""

import ctypes
import os
import shutil
import struct
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import cached_property, lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from kontur_av.closing import Closing
from kontur_av.errors import ConfigError, whole
from kontur_av.media import I420, AudioFrame, CaptureStamp, Quality, VideoFrame, check_size
from kontur_av.topics.file_node import FileNode
from kontur_av.topics.notifier import NotificationListener, Notifier, WaitSet
from kontur_av.topics.session_files import (
    SHARED_MEMORY,
    choose_session,
    join_session,
    joins_path,
    leave_session,
    notifier_path,
    open_own_file,
    sessions,
    shared_memory_prefix,
)

if TYPE_CHECKING:
    from kontur_av.topics.iceoryx_node import IceoryxNode

MAX_READERS = 16
#: A recorder that sleeps half a second loses nothing of a topic with 50 samples a second.
MAX_DEPTH = 32
#: The most octets of a sample: 1 GiB.
MOST_OCTETS = 1 << 30
_SOURCE_OCTETS = 16

SampleView = NDArray[np.uint8]


#: The header of every sample, in native byte order because it never leaves the machine.
_HEADER = struct.Struct(f"=qqQqQII{_SOURCE_OCTETS}s")
#: By their number: calling the enumeration takes several times as long.
_QUALITIES = tuple(Quality)
#: What iceoryx2's own `loan_slice_uninit` calls.
_LOAN = "__loan_slice_uninit"
#: The `rtp_timestamp` of a sample that was not received by RTP.
_NO_TIMESTAMP = -1


def _header(stamp: CaptureStamp, width: int, height: int) -> bytes:
    source = stamp.source.encode("ascii", "replace")[: _SOURCE_OCTETS - 1]
    timestamp = _NO_TIMESTAMP if stamp.rtp_timestamp is None else stamp.rtp_timestamp
    return _HEADER.pack(
        *(stamp.capture_ns, time.monotonic_ns()),
        *(stamp.sequence, timestamp, stamp.quality),
        *(width, height, source),
    )


class Loan:
    """A buffer in shared memory that its writer fills, then publishes or gives back."""

    def __init__(
        self, sample: Any, octets: int, width: int, height: int, published: Callable[[], None]
    ) -> None:
        self._sample = sample
        self._published = published
        self._octets = octets
        self._width = width
        self._height = height

    @cached_property
    def payload(self) -> SampleView:
        """The buffer: (octets,), uint8, writable."""
        return _view(self._sample, self._octets)

    @property
    def picture(self) -> I420:
        """The buffer as an I420 picture, shape (height * 3 // 2, width), uint8, writable."""
        return self.payload.reshape(self._height * 3 // 2, self._width)

    def publish(self, stamp: CaptureStamp) -> None:
        """Send the buffer to the readers. Do not touch it afterwards."""
        # One copy; setting the fields one by one through ctypes takes several times as long.
        header = _header(stamp, self._width, self._height)
        ctypes.memmove(self._sample.user_header_ptr, header, len(header))
        self._sample.assume_init().send()
        self._published()

    def give_back(self) -> None:
        """Return the buffer without publishing it."""
        self._sample.delete()


class Writer:
    """Publishes to one topic. Never blocks; the readers' oldest samples are dropped instead."""

    def __init__(
        self, publisher: Any, readers: Callable[[], int], notifier: Notifier | None, joins: Path
    ) -> None:
        # The method itself examines annotations each time, which takes ten times as long.
        self._loan = getattr(publisher, _LOAN, publisher.loan_slice_uninit)
        self._readers = readers
        self._notifier = notifier
        self._joins = joins

    def has_readers(self) -> bool:
        """Whether the topic has a reader. A killed reader may count for some time."""
        return bool(self._readers())

    def joins(self) -> int:
        """How many readers have ever joined the topic.

        The number of present readers does not show one that takes the place of a killed one.
        """
        return self._joins.stat().st_size if self._joins.exists() else 0

    def loan(self, octets: int, width: int = 0, height: int = 0) -> Loan:
        """Return a buffer of `octets` octets in shared memory."""
        sample = self._loan(octets)
        return Loan(sample, octets, width, height, self._wake)

    def loan_picture(self, width: int, height: int) -> Loan:
        """Return a buffer for one I420 picture; ConfigError if the size is unfit for 4:2:0."""
        check_size(width, height)
        return self.loan(width * height * 3 // 2, width, height)

    def publish_octets(self, data: bytes, stamp: CaptureStamp) -> None:
        """Copy `data` into the topic."""
        sample = self._loan(len(data))
        # The data lie right behind the header, so one copy does for both.
        record = _header(stamp, 0, 0) + data
        ctypes.memmove(sample.user_header_ptr, record, len(record))
        sample.assume_init().send()
        self._wake()

    def publish_video(self, frame: VideoFrame) -> None:
        """Copy a picture into the topic."""
        loan = self.loan_picture(frame.width, frame.height)
        np.copyto(loan.picture, frame.data)
        loan.publish(frame.stamp)

    def publish_audio(self, frame: AudioFrame) -> None:
        """Copy a block of sound into the topic."""
        self.publish_octets(frame.samples.tobytes(), frame.stamp)

    def _wake(self) -> None:
        if self._notifier is not None:
            self._notifier.notify()


class Lease:
    """A reader's hold on one sample. Its views are valid until `release`.

    published_ns: when its writer published it, on the clock of `MonotonicClock`.
    """

    def __init__(self, sample: Any) -> None:
        self._sample = sample
        header = _HEADER.unpack(ctypes.string_at(sample.user_header_ptr, _HEADER.size))
        capture_ns, self.published_ns, sequence, timestamp, quality, *size, source = header
        self.width, self.height = size
        self.stamp = CaptureStamp(
            capture_ns,
            sequence,
            source.rstrip(b"\0").decode("ascii"),
            _QUALITIES[quality],
            None if timestamp == _NO_TIMESTAMP else timestamp,
        )

    @cached_property
    def payload(self) -> SampleView:
        """The sample's octets: (octets,), uint8, read-only."""
        view = _view(self._sample, self._sample.header.number_of_elements)
        view.flags.writeable = False
        return view

    def octets(self) -> bytes:
        """Return a copy of the sample's octets, which for few octets is cheaper than a view."""
        sample = self._sample
        return ctypes.string_at(sample.payload_ptr, sample.header.number_of_elements)

    def video(self) -> VideoFrame:
        """Return the sample as a picture: a view, not a copy."""
        return VideoFrame(self.payload.reshape(self.height * 3 // 2, self.width), self.stamp)

    def audio(self) -> AudioFrame:
        """Return the sample as sound, int16: a view, not a copy."""
        return AudioFrame(self.payload.view(np.int16), self.stamp)

    def release(self) -> None:
        """Release the sample; do not touch its views afterwards."""
        if self._sample is not None:
            self._sample.delete()
            self._sample = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()


def _copied(sample: Any) -> bytes | None:
    """Return the octets of a sample and release it, without reading its stamp."""
    if sample is None:
        return None
    octets = ctypes.string_at(sample.payload_ptr, sample.header.number_of_elements)
    sample.delete()
    return octets


class Reader:
    """Reads one topic: either the newest sample (`latest`) or each in turn (`next`)."""

    def __init__(
        self,
        subscriber: Any,
        listener: NotificationListener,
        joins: Path,
        closed: Callable[["Reader"], None] = lambda _: None,
    ) -> None:
        self._subscriber = subscriber
        self._joins, self._closed = joins, closed
        self._wait_set: WaitSet | None = None
        #: For `TopicBus.waiter`.
        self.listener = listener
        #: Samples that `latest` skipped because a newer one was there.
        self.skipped = 0
        self.rejoin()

    def rejoin(self) -> None:
        """Let the writer see a reader that joins, because this one has to begin anew."""
        # Without room there is no count, and the next key picture comes by itself.
        with (
            suppress(OSError),
            os.fdopen(open_own_file(self._joins, os.O_APPEND), "ab") as joins,
        ):
            joins.write(b"\0")

    def wait(self, timeout_ns: int) -> bool:
        """Wait for a sample; return False if `timeout_ns` passed without one."""
        has_samples = self._subscriber.has_samples
        if has_samples():
            return True
        if self._wait_set is None:
            self._wait_set = WaitSet([self.listener])
        # A notification may concern a sample that was read already; then keep waiting.
        return self._wait_set.wait(timeout_ns, has_samples) or bool(has_samples())

    def close(self) -> None:
        """Leave the topic; a second call does nothing."""
        if self._subscriber is None:
            return
        self._wait_set = None
        self._subscriber.delete()
        self._subscriber = None
        self.listener.close()
        self._closed(self)

    def has_new(self) -> bool:
        """Whether there is a sample that was not read yet."""
        return bool(self._subscriber.has_samples())

    def next(self) -> Lease | None:
        """The oldest sample that was not read yet, or None."""
        sample = self._subscriber.receive()
        return None if sample is None else Lease(sample)

    def next_octets(self) -> bytes | None:
        """As `next`: a copy of the sample's octets, which needs no release."""
        return _copied(self._subscriber.receive())

    def latest_octets(self) -> bytes | None:
        """As `latest`: a copy of the sample's octets, which needs no release."""
        return _copied(self._newest())

    def latest(self) -> Lease | None:
        """The newest sample, or None; older ones are released and counted in `skipped`."""
        newest = self._newest()
        return None if newest is None else Lease(newest)

    def _newest(self) -> Any:
        newest = self._subscriber.receive()
        if newest is None:
            return None
        while self._subscriber.has_samples():
            newer = self._subscriber.receive()
            if newer is None:
                break
            newest.delete()
            newest = newer
            self.skipped += 1
        return newest


class TopicBus(Closing):
    """One process's access to the topics of one session.

    session: lower-case letters, digits and hyphens. It names the shared memory, so that two
    sessions on one machine stay separate. The last bus of a session that no launcher has started
    removes its topics at `close`.

    Do not fork a process that has a bus: the child would hold the locks that show whether the
    parent is alive. Fork first, then open the bus in the child.
    """

    def __init__(self, session: str) -> None:
        shared_memory_prefix(session)
        self._users = join_session(session)
        try:
            self._node = _open_node(session)
        except BaseException:
            leave_session(session, self._users)
            raise
        self._session = session
        self._joined = False
        self._ports: list[Any] = []
        self._notifiers: list[Notifier] = []
        self._readers: set[Reader] = set()

    @classmethod
    def join(cls, session: str | None = None) -> Self:
        """Return the bus of a running session.

        session: its name, the name of its setup, or None for the only session.
        Raises ConfigError, with the running sessions, if there is no such session. Opening a topic
        that the session does not have then raises ConfigError too, and leaves nothing behind.
        """
        bus = cls(choose_session(session, sessions()))
        bus._joined = True
        return bus

    def topics(self) -> list[str]:
        """Return the present topics of the session, sorted by name."""
        return sorted(self._node.topics())

    def writer(self, topic: str, *, max_octets: int, wake: bool = True) -> Writer:
        """Return a writer for samples of up to `max_octets` octets.

        wake: False leaves sleeping readers asleep, for state that is polled.

        Raises ConfigError if shared memory has no room for it. What it usually needs is reserved
        here: a page that the kernel cannot give later would end the process by SIGBUS.
        """
        max_octets = whole(max_octets, "max_octets", least=1, most=MOST_OCTETS)
        try:
            publisher, readers = self._node.publisher(topic, max_octets, present=self._joined)
        except KeyError:
            raise self._no_topic(topic) from None
        except OSError as error:
            raise ConfigError(shared_memory_full(error)) from None
        notifier = Notifier(notifier_path(self._session, topic)) if wake else None
        self._ports.append(publisher)
        if notifier is not None:
            self._notifiers.append(notifier)
        return Writer(publisher, readers, notifier, joins_path(self._session, topic))

    def reader(self, topic: str, *, depth: int = 1) -> Reader:
        """Return a reader that keeps at most `depth` unread samples; the oldest are dropped."""
        depth = whole(depth, "depth", least=1, most=MAX_DEPTH)
        try:
            subscriber = self._node.subscriber(topic, depth, present=self._joined)
        except KeyError:
            raise self._no_topic(topic) from None
        listener = NotificationListener(notifier_path(self._session, topic))
        joins = joins_path(self._session, topic)
        reader = Reader(subscriber, listener, joins, self._readers.discard)
        self._readers.add(reader)
        return reader

    def waiter(self, readers: Sequence[Reader], sockets: Sequence[int] = ()) -> WaitSet:
        """Return a wait set for any of several readers and file descriptors.

        After a wake-up, read all that is there: only what is published later wakes again.
        """
        return WaitSet([reader.listener for reader in readers], sockets)

    def close(self) -> None:
        """Close the ports, then the node. A second call does nothing."""
        if self._users < 0:
            return
        for reader in list(self._readers):
            reader.close()
        while self._notifiers:
            self._notifiers.pop().close()
        while self._ports:
            self._ports.pop().delete()
        self._node.close()
        leave_session(self._session, self._users)
        self._users = -1

    def _no_topic(self, topic: str) -> ConfigError:
        known = ", ".join(self.topics()) or "none"
        return ConfigError(f"session {self._session} has no topic {topic}: it has {known}")


def topics_are_files(session: str) -> bool:
    """Whether a session's topics are files, or would be; else they are iceoryx2's."""
    chosen = os.environ.get("KONTUR_AV_TOPICS", "")
    if chosen not in ("", "files"):
        raise ConfigError(f"KONTUR_AV_TOPICS={chosen}: write files, or leave it out")
    return bool(chosen) or find_spec("iceoryx2") is None or FileNode.present(session)


def _open_node(session: str) -> "FileNode | IceoryxNode":
    if topics_are_files(session):
        return FileNode(session, _HEADER.size)
    from kontur_av.topics.iceoryx_node import IceoryxNode

    return IceoryxNode(session, _HEADER.size, most_readers=MAX_READERS, most_depth=MAX_DEPTH)


@lru_cache(maxsize=64)
def _octets_type(octets: int) -> Any:
    """Return the ctypes array of this length. Making a type takes longer than making its view."""
    return ctypes.c_uint8 * octets


def shared_memory_full(error: OSError) -> str:
    """One line about shared memory without room, with the fix."""
    free = shutil.disk_usage(SHARED_MEMORY).free
    return (
        f"shared memory is full ({error.strerror}, {free / 1e6:.0f} MB free in {SHARED_MEMORY}): "
        "end the program that fills it, or give more (in a container: --shm-size=256m)"
    )


def _view(sample: Any, octets: int) -> SampleView:
    # From the address, because NumPy would have to convert the format of iceoryx2's memoryview.
    memory: Any = _octets_type(octets).from_address(sample.payload_ptr)
    return np.ndarray((octets,), np.uint8, memory)
