"""Topics in shared memory: publish once, any number of readers, nobody waits for anybody.

This is a thin layer over iceoryx2 (https://iceoryx.io). The writer fills a buffer in shared memory;
a reader sees the same octets without a copy. A slow reader loses the oldest samples and never
blocks the writer. A killed process affects no other; its resources are freed when the next process
joins. The topic's notifier wakes all sleeping readers with one system call of the writer;
iceoryx2's own events need one for each reader.

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
from functools import cached_property, lru_cache
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import iceoryx2 as iox2
import numpy as np
from numpy.typing import NDArray

from kontur_av.errors import ConfigError
from kontur_av.media import I420, AudioFrame, CaptureStamp, Quality, VideoFrame, check_size
from kontur_av.topics.notifier import NotificationListener, Notifier, WaitSet
from kontur_av.topics.session_files import (
    SHARED_MEMORY,
    choose_session,
    make_session_root,
    notifier_path,
    sessions,
    shared_memory_prefix,
    topics_root,
)

MAX_READERS = 16
#: A killed writer counts until another process has cleaned up after it.
_MAX_WRITERS = 4
_MAX_NODES = 64
#: A recorder that sleeps half a second loses nothing of a topic with 50 samples a second. Room in
#: shared memory is taken only when it is written, but for what a writer reserves.
_MAX_DEPTH = 32
#: A writer's samples at first, of which usually no more are in use: of a large one, and octets.
_RESERVED_SAMPLES, _RESERVED_OCTETS = 5, 1 << 20
#: Two that a reader holds, and one that `latest` receives before it releases an older one.
_MAX_LEASES = 3
_SOURCE_OCTETS = 16
#: At most, of iceoryx2's own header and alignment.
_SAMPLE_OVERHEAD = 256

SampleView = NDArray[np.uint8]


class _Header(ctypes.Structure):
    """The header of every sample, in native byte order because it never leaves the machine.

    This class tells iceoryx2 size and alignment; `_HEADER` is the same layout for packing.
    """

    _fields_ = (
        ("capture_ns", ctypes.c_int64),
        ("published_ns", ctypes.c_int64),
        ("sequence", ctypes.c_uint64),
        ("rtp_timestamp", ctypes.c_int64),
        ("quality", ctypes.c_uint64),
        ("width", ctypes.c_uint32),
        ("height", ctypes.c_uint32),
        ("source", ctypes.c_char * _SOURCE_OCTETS),
    )


_HEADER = struct.Struct(f"=qqQqQII{_SOURCE_OCTETS}s")
assert _HEADER.size == ctypes.sizeof(_Header)
#: By their number: calling the enumeration takes several times as long.
_QUALITIES = tuple(Quality)
#: What iceoryx2's own `loan_slice_uninit` calls.
_LOAN = "__loan_slice_uninit"
#: The `rtp_timestamp` of a sample that was not received by RTP.
_NO_TIMESTAMP = -1


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
        source = stamp.source.encode("ascii", "replace")[: _SOURCE_OCTETS - 1]
        timestamp = _NO_TIMESTAMP if stamp.rtp_timestamp is None else stamp.rtp_timestamp
        header = _HEADER.pack(
            *(stamp.capture_ns, time.monotonic_ns()),
            *(stamp.sequence, timestamp, stamp.quality),
            *(self._width, self._height, source),
        )
        # One copy; setting the fields one by one through ctypes takes several times as long.
        ctypes.memmove(self._sample.user_header_ptr, header, len(header))
        self._sample.assume_init().send()
        self._published()

    def give_back(self) -> None:
        """Return the buffer without publishing it."""
        self._sample.delete()


class Writer:
    """Publishes to one topic. Never blocks; the readers' oldest samples are dropped instead."""

    def __init__(self, publisher: Any, service: Any, notifier: Notifier | None) -> None:
        # The method itself examines annotations each time, which takes ten times as long.
        self._loan = getattr(publisher, _LOAN, publisher.loan_slice_uninit)
        self._service = service
        self._notifier = notifier

    def has_readers(self) -> bool:
        """Whether the topic has a reader. A killed reader may count for some time."""
        return bool(self._service.dynamic_config.number_of_subscribers)

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
        ctypes.memmove(sample.payload_ptr, data, len(data))
        Loan(sample, len(data), 0, 0, self._wake).publish(stamp)

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

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.release()


class Reader:
    """Reads one topic: either the newest sample (`latest`) or each in turn (`next`)."""

    def __init__(
        self,
        subscriber: Any,
        listener: NotificationListener,
        closed: Callable[["Reader"], None] = lambda _: None,
    ) -> None:
        self._subscriber = subscriber
        self._closed = closed
        self._wait_set: WaitSet | None = None
        #: For a `Waiter`.
        self.listener = listener
        #: Samples that `latest` skipped because a newer one was there.
        self.skipped = 0

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

    def latest(self) -> Lease | None:
        """The newest sample, or None; older ones are released and counted in `skipped`."""
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
        return Lease(newest)


class TopicBus:
    """One process's access to the topics of one session.

    session: lower-case letters, digits and hyphens. It names the shared memory, so that two
    sessions on one machine stay separate.

    Do not fork a process that has a bus: the child would hold the locks that show whether the
    parent is alive. Fork first, then open the bus in the child.
    """

    def __init__(self, session: str) -> None:
        config = iox2.config.default()
        config.global_cfg.prefix = iox2.FileName.new(shared_memory_prefix(session))
        root = topics_root(session)
        make_session_root(session)
        root.mkdir(mode=0o700, exist_ok=True)
        config.global_cfg.root_path = iox2.Path.new(str(root))
        iox2.set_log_level(iox2.LogLevel.Error)
        self._node: Any = (
            iox2.NodeBuilder.new()
            .config(config)
            .signal_handling_mode(iox2.SignalHandlingMode.Disabled)
            .create(iox2.ServiceType.Ipc)
        )
        self._session = session
        self._config = config
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
        found: list[Any] = iox2.Service.list(self._config, iox2.ServiceType.Ipc)
        return sorted(service.name().to_string() for service in found)

    def writer(self, topic: str, *, max_octets: int, wake: bool = True) -> Writer:
        """Return a writer for samples of up to `max_octets` octets.

        wake: False leaves sleeping readers asleep, for state that is polled.

        Raises ConfigError if shared memory has no room for it. What it usually needs is reserved
        here: a page that the kernel cannot give later would end the process by SIGBUS.
        """
        service = self._data_service(topic)
        before = _segments()
        publisher = (
            service.publisher_builder()
            .initial_max_slice_len(max_octets)
            .allocation_strategy(iox2.AllocationStrategy.PowerOfTwo)
            .max_loaned_samples(2)
            .backpressure_strategy(iox2.BackpressureStrategy.DiscardData)
            .create()
        )
        try:
            for path in _segments() - before:
                _reserve(path, max_octets)
        except OSError as error:
            publisher.delete()
            raise ConfigError(shared_memory_full(error)) from None
        notifier = Notifier(notifier_path(self._session, topic)) if wake else None
        self._ports.append(publisher)
        if notifier is not None:
            self._notifiers.append(notifier)
        return Writer(publisher, service, notifier)

    def reader(self, topic: str, *, depth: int = 1) -> Reader:
        """Return a reader that keeps at most `depth` unread samples; the oldest are dropped."""
        if not 1 <= depth <= _MAX_DEPTH:
            raise ValueError(f"depth {depth}: from 1 to {_MAX_DEPTH}")
        service = self._data_service(topic)
        listener = NotificationListener(notifier_path(self._session, topic))
        subscriber = service.subscriber_builder().buffer_size(depth).create()
        reader = Reader(subscriber, listener, self._readers.discard)
        self._readers.add(reader)
        return reader

    def waiter(self, readers: Sequence[Reader], sockets: Sequence[int] = ()) -> "Waiter":
        """Return a waiter for any of several readers and file descriptors."""
        return Waiter(readers, sockets)

    def close(self) -> None:
        """Close the ports, then the node."""
        for reader in list(self._readers):
            reader.close()
        while self._notifiers:
            self._notifiers.pop().close()
        while self._ports:
            self._ports.pop().delete()
        self._node = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _data_service(self, topic: str) -> Any:
        service = (
            self._node.service_builder(iox2.ServiceName.new(topic))
            .publish_subscribe(iox2.Slice[ctypes.c_uint8])
            .user_header(_Header)
            .max_publishers(_MAX_WRITERS)
            .max_subscribers(MAX_READERS)
            .max_nodes(_MAX_NODES)
            .subscriber_max_buffer_size(_MAX_DEPTH)
            .subscriber_max_borrowed_samples(_MAX_LEASES)
            .history_size(1)
            .enable_safe_overflow(True)
        )
        if not self._joined:
            return service.open_or_create()
        try:
            return service.open()
        except iox2.PublishSubscribeOpenError:
            known = ", ".join(self.topics()) or "none"
            raise ConfigError(
                f"session {self._session} has no topic {topic}: it has {known}"
            ) from None


class Waiter:
    """Waits until one of several readers has something new, or a file descriptor is readable.

    After a wake-up, read all that is there: only what is published later wakes again.
    """

    def __init__(self, readers: Sequence[Reader], sockets: Sequence[int] = ()) -> None:
        self._wait_set = WaitSet([reader.listener for reader in readers], sockets)

    def fileno(self) -> int:
        """Return a descriptor for an event loop. When it is readable, call `wait(0)`, then read."""
        return self._wait_set.fileno()

    def wait(self, timeout_ns: int) -> bool:
        """Wait until there may be something to read; return False on timeout."""
        return self._wait_set.wait(timeout_ns)


@lru_cache(maxsize=64)
def _octets_type(octets: int) -> Any:
    """Return the ctypes array of this length. Making a type takes longer than making its view."""
    return ctypes.c_uint8 * octets


def shared_memory_full(error: OSError) -> str:
    """One line about shared memory without room, with the mend."""
    free = shutil.disk_usage(SHARED_MEMORY).free
    return (
        f"shared memory is full ({error.strerror}, {free / 1e6:.0f} MB free in {SHARED_MEMORY}): "
        "end the program that fills it, or give more (in a container: --shm-size=256m)"
    )


def _segments() -> set[str]:
    """The segments with samples that this process has mapped."""
    with Path("/proc/self/maps").open(encoding="utf-8", errors="replace") as maps:
        paths = {line.rpartition(" ")[2].rstrip("\n") for line in maps if "_0.data" in line}
    return {path for path in paths if path.endswith("_0.data")}


def _reserve(segment: str, max_octets: int) -> None:
    """Take the pages of the first samples of a segment; OSError if there are too few.

    iceoryx2 uses the lowest sample that is free.
    """
    samples = min(max(_RESERVED_OCTETS // max_octets, _RESERVED_SAMPLES), _MAX_DEPTH)
    descriptor = os.open(segment, os.O_RDWR | os.O_CLOEXEC)
    try:
        wanted = samples * (max_octets + _HEADER.size + _SAMPLE_OVERHEAD)
        os.posix_fallocate(descriptor, 0, min(wanted, os.fstat(descriptor).st_size))
    finally:
        os.close(descriptor)


def _view(sample: Any, octets: int) -> SampleView:
    # From the address, because NumPy would have to convert the format of iceoryx2's memoryview.
    memory: Any = _octets_type(octets).from_address(sample.payload_ptr)
    return np.ndarray((octets,), np.uint8, memory)
