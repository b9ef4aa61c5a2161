"""The topics of a session by iceoryx2 (https://iceoryx.io), with limits and reserved pages."""

import ctypes
import errno
import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import iceoryx2 as iox2

from kontur_av.topics.session_files import (
    SHARED_MEMORY,
    make_session_root,
    shared_memory_prefix,
    topics_root,
)

#: A killed writer counts until another process has cleaned up after it.
_MAX_WRITERS = 4
_MAX_NODES = 64
#: A writer's samples at first, of which usually no more are in use: of a large one, and octets.
#: Other room in shared memory is taken only when it is written.
_RESERVED_SAMPLES, _RESERVED_OCTETS = 5, 1 << 20
#: Two that a reader holds, and one that `latest` receives before it releases an older one.
_MAX_LEASES = 3
#: The longest wait for another process that is creating the same topic.
_CREATION_S = 5
#: At most, of iceoryx2's own header and alignment.
_SAMPLE_OVERHEAD = 256


class IceoryxNode:
    """One process's access to the topics of one session.

    header_octets: of what goes before each sample. most_readers: of a topic. most_depth: of a
    reader's queue.
    """

    def __init__(
        self, session: str, header_octets: int, *, most_readers: int, most_depth: int
    ) -> None:
        config = iox2.config.default()
        self._prefix = shared_memory_prefix(session)
        config.global_cfg.prefix = iox2.FileName.new(self._prefix)
        root = topics_root(session)
        make_session_root(session)
        root.mkdir(mode=0o700, exist_ok=True)
        config.global_cfg.root_path = iox2.Path.new(str(root))
        # A process that another one holds up for longer (1 s by default) would end.
        config.global_cfg.creation_timeout = iox2.Duration.from_secs(_CREATION_S)
        iox2.set_log_level(iox2.LogLevel.Error)
        try:
            self._node: Any = (
                iox2.NodeBuilder.new()
                .config(config)
                .signal_handling_mode(iox2.SignalHandlingMode.Disabled)
                .create(iox2.ServiceType.Ipc)
            )
        except iox2.NodeCreationFailure as error:
            # The directory is there and ours, so its disk is full.
            raise OSError(errno.ENOSPC, f"no file can be made there ({error})", str(root)) from None
        # iceoryx2 creates this file with mode 0666. Truncating it hangs every process.
        for path in SHARED_MEMORY.glob(f"{self._prefix}*.global_mgmt"):
            with suppress(FileNotFoundError):
                path.chmod(0o600)
        self._config, self._most_readers, self._most_depth = config, most_readers, most_depth
        self._header_octets = header_octets
        fields = [("words", ctypes.c_uint64 * (header_octets // 8))]
        self._header: Any = type("_Header", (ctypes.Structure,), {"_fields_": fields})
        #: Topics that were opened: opening one takes as long as joining it.
        self._services: dict[str, Any] = {}

    def topics(self) -> list[str]:
        found: list[Any] = iox2.Service.list(self._config, iox2.ServiceType.Ipc)
        return [service.name().to_string() for service in found]

    def publisher(
        self, topic: str, max_octets: int, *, present: bool
    ) -> tuple[Any, Callable[[], int]]:
        """Return a publisher, and what counts its readers.

        present: KeyError if there is no such topic. OSError: no room in shared memory.
        """
        service = self._service(topic, present=present)
        publisher = (
            service.publisher_builder()
            .initial_max_slice_len(max_octets)
            .allocation_strategy(iox2.AllocationStrategy.PowerOfTwo)
            .max_loaned_samples(2)
            .backpressure_strategy(iox2.BackpressureStrategy.DiscardData)
            .create()
        )
        try:
            # iceoryx2 names a publisher's first segment so.
            (segment,) = SHARED_MEMORY.glob(f"{self._prefix}*_{publisher.id.value}__0.data")
            self._reserve(segment, max_octets)
        except OSError:
            publisher.delete()
            raise
        return publisher, lambda: int(service.dynamic_config.number_of_subscribers)

    def subscriber(self, topic: str, depth: int, *, present: bool) -> Any:
        """Return a subscriber with a queue of `depth` samples. present: see `publisher`."""
        service = self._service(topic, present=present)
        return service.subscriber_builder().buffer_size(depth).create()

    def close(self) -> None:
        """Give up the node, after its ports."""
        self._services.clear()
        self._node = None

    def _service(self, topic: str, *, present: bool) -> Any:
        if (known := self._services.get(topic)) is not None:
            return known
        service = (
            self._node.service_builder(iox2.ServiceName.new(topic))
            .publish_subscribe(iox2.Slice[ctypes.c_uint8])
            .user_header(self._header)
            .max_publishers(_MAX_WRITERS)
            .max_subscribers(self._most_readers)
            .max_nodes(_MAX_NODES)
            .subscriber_max_buffer_size(self._most_depth)
            .subscriber_max_borrowed_samples(_MAX_LEASES)
            .history_size(1)
            .enable_safe_overflow(True)
        )
        try:
            opened = service.open() if present else service.open_or_create()
        except iox2.PublishSubscribeOpenError:
            raise KeyError(topic) from None
        self._services[topic] = opened
        return opened

    def _reserve(self, segment: Path, max_octets: int) -> None:
        """Take the pages of the first samples, the lowest of which is used; OSError: too few."""
        samples = min(max(_RESERVED_OCTETS // max_octets, _RESERVED_SAMPLES), self._most_depth)
        descriptor = os.open(segment, os.O_RDWR | os.O_CLOEXEC)
        try:
            wanted = samples * (max_octets + self._header_octets + _SAMPLE_OVERHEAD)
            os.posix_fallocate(descriptor, 0, min(wanted, os.fstat(descriptor).st_size))
        finally:
            os.close(descriptor)
