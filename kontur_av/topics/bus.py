"""Shared-memory topics: publish once, any number of readers, nobody waits for anybody.

A thin front of iceoryx2 (https://iceoryx.io): the writer fills a buffer that lies in shared
memory already, a reader sees the same octets without a copy. A slow reader loses the oldest
samples and never holds up the writer; a process that is killed takes nobody else along, and
what it held is taken back when the next one joins. Readers that sleep are woken by the topic's
bell, all with one system call of the writer: iceoryx2's own events take one for each.

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
import struct
from collections.abc import Callable, Sequence
from functools import cached_property
from types import TracebackType
from typing import Any, Self

import iceoryx2 as iox2
import numpy as np
from numpy.typing import NDArray

from kontur_av.errors import ConfigError
from kontur_av.media import I420, AudioFrame, CaptureStamp, VideoFrame, check_size
from kontur_av.topics.bell import Bell, Ear, Sleeper
from kontur_av.topics.session_files import (
    bell_path,
    choose_session,
    make_session_root,
    sessions,
    shared_memory_prefix,
    topics_root,
)

MAX_READERS = 16
#: A killed writer counts until somebody has cleaned up after it.
_MAX_WRITERS = 4
_MAX_NODES = 64
_MAX_DEPTH = 8
#: Two that a reader holds, and one more that `latest` has in hand while it lets an older one go.
_MAX_LEASES = 3
_SOURCE_OCTETS = 16

SampleView = NDArray[np.uint8]


class _Header(ctypes.Structure):
    """What travels with every sample, in the machine's own byte order: it never leaves it.

    It tells iceoryx2 size and alignment; `_HEADER` is the same for who writes and reads it.
    """

    _fields_ = (
        ("capture_ns", ctypes.c_int64),
        ("sequence", ctypes.c_uint64),
        ("width", ctypes.c_uint32),
        ("height", ctypes.c_uint32),
        ("source", ctypes.c_char * _SOURCE_OCTETS),
    )


_HEADER = struct.Struct(f"=qQII{_SOURCE_OCTETS}s")
assert _HEADER.size == ctypes.sizeof(_Header)


class Loan:
    """A buffer in shared memory that its writer fills and then publishes, or gives back."""

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
        """The buffer, writable."""
        return _view(self._sample, self._octets)

    @property
    def picture(self) -> I420:
        """The buffer as an I420 picture, shape (height * 3 // 2, width), uint8, writable."""
        return self.payload.reshape(self._height * 3 // 2, self._width)

    def publish(self, stamp: CaptureStamp) -> None:
        """Hand the buffer to the readers. It may not be touched afterwards."""
        source = stamp.source.encode("ascii", "replace")[: _SOURCE_OCTETS - 1]
        header = _HEADER.pack(stamp.capture_ns, stamp.sequence, self._width, self._height, source)
        # One copy, where fields set one by one through ctypes take several times as long.
        ctypes.memmove(self._sample.user_header_ptr, header, len(header))
        self._sample.assume_init().send()
        self._published()

    def give_back(self) -> None:
        """Return the buffer unpublished."""
        self._sample.delete()


class Writer:
    """Publishes into one topic. Never blocks; the readers' oldest samples give way."""

    def __init__(self, publisher: Any, service: Any, bell: Bell | None) -> None:
        self._publisher = publisher
        self._service = service
        self._bell = bell

    def has_readers(self) -> bool:
        """Whether somebody reads the topic. A reader that was killed may count for some time."""
        return bool(self._service.dynamic_config.number_of_subscribers)

    def loan(self, octets: int, width: int = 0, height: int = 0) -> Loan:
        """A buffer of `octets` octets in shared memory."""
        sample = self._publisher.loan_slice_uninit(octets)
        return Loan(sample, octets, width, height, self._wake)

    def loan_picture(self, width: int, height: int) -> Loan:
        """A buffer for one I420 picture; ConfigError when the size is unfit for 4:2:0."""
        check_size(width, height)
        return self.loan(width * height * 3 // 2, width, height)

    def publish_octets(self, data: bytes, stamp: CaptureStamp) -> None:
        """Copy `data` into the topic."""
        sample = self._publisher.loan_slice_uninit(len(data))
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
        if self._bell is not None:
            self._bell.ring()


class Lease:
    """A reader's hold on one sample. Views of it are valid until `release`."""

    def __init__(self, sample: Any) -> None:
        self._sample = sample
        capture_ns, sequence, self.width, self.height, source = _HEADER.unpack(
            ctypes.string_at(sample.user_header_ptr, _HEADER.size)
        )
        self.stamp = CaptureStamp(capture_ns, sequence, source.rstrip(b"\0").decode("ascii"))

    @cached_property
    def payload(self) -> SampleView:
        """The sample's octets, read-only."""
        view = _view(self._sample, self._sample.header.number_of_elements)
        view.flags.writeable = False
        return view

    def octets(self) -> bytes:
        """A copy of the sample's octets: cheaper than a view, where they are few."""
        sample = self._sample
        return ctypes.string_at(sample.payload_ptr, sample.header.number_of_elements)

    def video(self) -> VideoFrame:
        """The sample as a picture: a view, not a copy."""
        return VideoFrame(self.payload.reshape(self.height * 3 // 2, self.width), self.stamp)

    def audio(self) -> AudioFrame:
        """The sample as sound: a view, not a copy."""
        return AudioFrame(self.payload.view(np.int16), self.stamp)

    def release(self) -> None:
        """Give the sample back; its views may not be touched afterwards."""
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
    """Reads one topic, either the newest sample (`latest`) or each in turn (`next`)."""

    def __init__(self, subscriber: Any, ear: Ear) -> None:
        self._subscriber = subscriber
        self._sleeper: Sleeper | None = None
        #: For a `Waiter`.
        self.ear = ear
        #: Samples passed over by `latest` because a newer one was there.
        self.skipped = 0

    def wait(self, timeout_ns: int) -> bool:
        """Sleep until something is there (True) or the time is over (False)."""
        has_samples = self._subscriber.has_samples
        if has_samples():
            return True
        if self._sleeper is None:
            self._sleeper = Sleeper([self.ear])
        # It may ring for a sample which was read already: then it sleeps on.
        return self._sleeper.sleep(timeout_ns, has_samples) or bool(has_samples())

    def close(self) -> None:
        """Leave the topic."""
        self._sleeper = None
        self._subscriber.delete()
        self.ear.close()

    def has_new(self) -> bool:
        """Whether a sample is there that was not read yet."""
        return bool(self._subscriber.has_samples())

    def next(self) -> Lease | None:
        """The oldest sample not yet read, or None."""
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
    """One process's door to the topics of one session.

    session: lower-case letters, digits and hyphens; it names the shared memory, so that two
    sessions on one machine do not meet.

    A process that has a bus may not fork: the child would hold the locks by which the others
    tell whether the parent is alive. Fork first, then open the bus in the child.
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
        self._bells: list[Bell] = []
        self._readers: list[Reader] = []

    @classmethod
    def join(cls, session: str | None = None) -> Self:
        """The bus of a session that runs already; None: of the only one, a setup's name: of its.

        A topic that the session does not have is a ConfigError then, and nothing is left behind.
        ConfigError, with the sessions that run, if there is no such session.
        """
        bus = cls(choose_session(session, sessions()))
        bus._joined = True
        return bus

    def topics(self) -> list[str]:
        """The topics of the session at present, by name."""
        found: list[Any] = iox2.Service.list(self._config, iox2.ServiceType.Ipc)
        return sorted(service.name().to_string() for service in found)

    def writer(self, topic: str, *, max_octets: int, wake: bool = True) -> Writer:
        """A writer for samples of up to `max_octets` octets.

        wake=False leaves the readers asleep: for state that is polled.
        """
        service = self._data_service(topic)
        publisher = (
            service.publisher_builder()
            .initial_max_slice_len(max_octets)
            .allocation_strategy(iox2.AllocationStrategy.PowerOfTwo)
            .max_loaned_samples(2)
            .backpressure_strategy(iox2.BackpressureStrategy.DiscardData)
            .create()
        )
        bell = Bell(bell_path(self._session, topic)) if wake else None
        self._ports.append(publisher)
        if bell is not None:
            self._bells.append(bell)
        return Writer(publisher, service, bell)

    def reader(self, topic: str, *, depth: int = 1) -> Reader:
        """A reader that keeps at most `depth` unread samples; beyond that the oldest goes."""
        if not 1 <= depth <= _MAX_DEPTH:
            raise ValueError(f"depth {depth}: from 1 to {_MAX_DEPTH}")
        service = self._data_service(topic)
        ear = Ear(bell_path(self._session, topic))
        subscriber = service.subscriber_builder().buffer_size(depth).create()
        reader = Reader(subscriber, ear)
        self._readers.append(reader)
        return reader

    def waiter(self, readers: Sequence[Reader], sockets: Sequence[int] = ()) -> "Waiter":
        """Waits for any of several readers and file descriptors at once."""
        return Waiter(readers, sockets)

    def close(self) -> None:
        """Give the ports back, then the node."""
        while self._readers:
            self._readers.pop().close()
        while self._bells:
            self._bells.pop().close()
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
    """Sleeps until one of several readers has something new, or a file descriptor is readable.

    Whoever was woken takes all that is there: only what is published later wakes again.
    """

    def __init__(self, readers: Sequence[Reader], sockets: Sequence[int] = ()) -> None:
        self._sleeper = Sleeper([reader.ear for reader in readers], sockets)

    def wait(self, timeout_ns: int) -> bool:
        """Sleep until something may be there (True) or the time is over (False)."""
        return self._sleeper.sleep(timeout_ns)


def _view(sample: Any, octets: int) -> SampleView:
    # From the address, because iceoryx2's own memoryview has a format that NumPy must convert.
    memory: Any = (ctypes.c_uint8 * octets).from_address(sample.payload_ptr)
    return np.ndarray((octets,), np.uint8, memory)
