"""Topics as files in shared memory, for machines without iceoryx2: pread(2) and pwrite(2) alone.

A topic is one file: its state, an index of the newest records, a ring of records. A writer tells
how far it will write, writes the record and its entry, then makes it the newest. A reader copies a
record, then looks whether a writer has begun to overwrite it meanwhile.

The kernel orders these calls between processes, on every kind of processor. A full memory is an
error when a writer starts, never SIGBUS.

Locks belong to open file descriptions (fcntl(2)), so that a killed process leaves none: octet 0 is
locked while a record is written, octet 1 by every reader. A writer that is stopped within a record
delays other writers of the topic.

The classes have those methods of iceoryx2's classes that `kontur_av.topics.bus` calls.
"""

import fcntl
import os
import struct
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Self

import numpy as np

from kontur_av.topics.session_files import open_own_file, shared_memory, topic_path

#: How the names of topic files end.
SUFFIX = ".topic"
_NUMBER = struct.Struct("=Q")
#: Octets of the ring; the first record that counts, the newest, and the end of all that was or is
#: being written. Records count from 1; an octet's place in the ring is modulo the ring's octets.
_STATE = struct.Struct("=QQQQ")
_FIRST_AT, _NEWEST_AT, _END_AT = 8, 16, 24
#: A record's number, first octet and octets, then these three by XOR, against torn reads.
_ENTRY = struct.Struct("=QQQQ")
_ENTRIES = 64
_INDEX_OCTETS = _STATE.size + _ENTRIES * _ENTRY.size
_NAME_AT, _RING_AT = 3072, 4096
#: A ring holds this many of the largest records, and more while they need less than this.
_FEW, _MANY, _SMALL_OCTETS = 5, 35, 1 << 20
#: Type, whence, start, length and process of a lock (fcntl(2)).
_LOCK = struct.Struct("@hhqqi4x")
_WRITERS, _READERS = 0, 1


class FileSample:
    """A private buffer: of a record to be sent, or with the copy of one."""

    def __init__(
        self, header_octets: int, octets: int, send: Callable[[memoryview], None] | None = None
    ) -> None:
        buffer = np.empty(header_octets + octets, np.uint8)
        self.buffer = buffer.data
        self.user_header_ptr = buffer.ctypes.data
        self.payload_ptr = self.user_header_ptr + header_octets
        self.header = SimpleNamespace(number_of_elements=octets)
        self._send = send

    def assume_init(self) -> Self:
        return self

    def send(self) -> None:
        assert self._send is not None
        self._send(self.buffer)

    def delete(self) -> None:
        """The buffer goes with its last view."""


class _TopicFile:
    def __init__(self, path: Path, header_octets: int) -> None:
        self._header_octets = header_octets
        self._fd = open_own_file(path)

    def delete(self) -> None:
        os.close(self._fd)

    def _state(self) -> tuple[int, int, int, int, bytes]:
        """Return the state, and with it the entries as octets. Zeros before the first writer."""
        found = os.pread(self._fd, _INDEX_OCTETS, 0)
        if len(found) < _INDEX_OCTETS:
            return 0, 1, 0, 0, found
        return *_STATE.unpack_from(found), found

    def _lock(self, octet: int, kind: int, how: int) -> int:
        """Return the kind of lock that there was, with F_OFD_GETLK."""
        found = fcntl.fcntl(self._fd, how, _LOCK.pack(kind, os.SEEK_SET, octet, 1, 0))
        return int(_LOCK.unpack(found)[0])


class FilePublisher(_TopicFile):
    """Writes records."""

    def __init__(self, path: Path, topic: str, header_octets: int, max_octets: int) -> None:
        super().__init__(path, header_octets)
        try:
            self._locked(partial(self._grow, header_octets + max_octets))
        except OSError:
            self.delete()
            raise
        os.pwrite(self._fd, topic.encode() + b"\0", _NAME_AT)

    def number_of_subscribers(self) -> int:
        """1 with readers, else 0."""
        return int(self._lock(_READERS, fcntl.F_WRLCK, fcntl.F_OFD_GETLK) != fcntl.F_UNLCK)

    def loan_slice_uninit(self, octets: int) -> FileSample:
        """Return a buffer for a record."""
        return FileSample(self._header_octets, octets, self._send)

    def _send(self, record: memoryview) -> None:
        self._locked(partial(self._append, record))

    def _locked(self, work: Callable[[], None]) -> None:
        self._lock(_WRITERS, fcntl.F_WRLCK, fcntl.F_OFD_SETLKW)
        try:
            work()
        finally:
            self._lock(_WRITERS, fcntl.F_UNLCK, fcntl.F_OFD_SETLK)

    def _append(self, record: memoryview) -> None:
        octets = len(record)
        ring, _, newest, end, _ = self._state()
        if ring < _FEW * octets:
            self._grow(octets)
            ring, _, newest, end, _ = self._state()
        # A record does not go over the ring's end.
        start = end if end % ring + octets <= ring else end + ring - end % ring
        number = newest + 1
        entry = _ENTRY.pack(number, start, octets, number ^ start ^ octets)
        self._put(_END_AT, start + octets)
        os.pwrite(self._fd, record, _RING_AT + start % ring)
        os.pwrite(self._fd, entry, _STATE.size + number % _ENTRIES * _ENTRY.size)
        self._put(_NEWEST_AT, number)

    def _grow(self, octets: int) -> None:
        """Give up all records for a ring of this size, if there is a smaller one; OSError: full."""
        ring, _, newest, end, _ = self._state()
        wanted = octets * min(max(_FEW, _SMALL_OCTETS // octets), _MANY)
        if ring >= wanted:
            return
        os.posix_fallocate(self._fd, 0, _RING_AT + wanted)
        self._put(_FIRST_AT, newest + 1)
        self._put(_END_AT, (end // wanted + 1) * wanted)
        self._put(0, wanted)

    def _put(self, at: int, number: int) -> None:
        os.pwrite(self._fd, _NUMBER.pack(number), at)


class FileSubscriber(_TopicFile):
    """Reads records, beginning after the newest one so far.

    depth: it goes on with the newest `depth` records when it was slower than the writer.
    """

    def __init__(self, path: Path, header_octets: int, depth: int) -> None:
        super().__init__(path, header_octets)
        self._lock(_READERS, fcntl.F_RDLCK, fcntl.F_OFD_SETLK)
        self._depth = depth
        self._next = self._state()[2] + 1

    def has_samples(self) -> bool:
        """Whether there is a record that was not read yet."""
        return self._next <= self._state()[2]

    def receive(self) -> FileSample | None:
        """Return the next record, or None."""
        while True:
            ring, first, newest, end, found = self._state()
            number = max(self._next, newest - self._depth + 1, first)
            if number > newest:
                return None
            self._next = number + 1
            at = _STATE.size + number % _ENTRIES * _ENTRY.size
            entry = _ENTRY.unpack_from(found, at)
            _, start, octets, check = entry
            if entry[0] != number or number ^ start ^ octets != check or start + ring < end:
                continue
            sample = FileSample(self._header_octets, octets - self._header_octets)
            os.preadv(self._fd, [sample.buffer], _RING_AT + start % ring)
            ring_now, _, _, end_now, _ = self._state()
            if ring_now == ring and start + ring >= end_now:
                return sample


class FileNode:
    """The topics of one session. header_octets: of what goes before each sample."""

    def __init__(self, session: str, header_octets: int) -> None:
        self._session, self._header_octets = session, header_octets

    @staticmethod
    def present(session: str) -> bool:
        """Whether a session has such topics."""
        return any(path.suffix == SUFFIX for path in shared_memory(session))

    def topics(self) -> list[str]:
        """Return the names of the topics with a writer."""
        files = [path for path in shared_memory(self._session) if path.suffix == SUFFIX]
        return [_name(path) for path in files if path.stat().st_size]

    def publisher(
        self, topic: str, max_octets: int, *, present: bool
    ) -> tuple[FilePublisher, Callable[[], int]]:
        """Return a writer, and what counts its readers: 1 stands for any number.

        present: KeyError if there is no such topic. OSError: no room in shared memory.
        """
        path = self._path(topic, present=present)
        writer = FilePublisher(path, topic, self._header_octets, max_octets)
        return writer, writer.number_of_subscribers

    def subscriber(self, topic: str, depth: int, *, present: bool) -> FileSubscriber:
        """Return a reader. depth, present: see `FileSubscriber` and `publisher`."""
        return FileSubscriber(self._path(topic, present=present), self._header_octets, depth)

    def close(self) -> None:
        """Nothing is left to close but readers and writers."""

    def _path(self, topic: str, *, present: bool) -> Path:
        path = topic_path(self._session, topic, SUFFIX)
        if present and not path.exists():
            raise KeyError(topic)
        return path


def _name(path: Path) -> str:
    with path.open("rb") as file:
        return os.pread(file.fileno(), _RING_AT - _NAME_AT, _NAME_AT).partition(b"\0")[0].decode()
