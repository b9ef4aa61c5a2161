"""What the readers of a session's channels count."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from kontur_av.metrics import Newest


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedChannel:
    """One channel, in messages."""

    #: In the file, or sent to clients.
    kept: int = 0
    #: Gone before they were read.
    missed: int = 0
    #: Dropped: the disk was too slow or full, or a client too slow.
    dropped: int = 0

    @property
    def lost(self) -> int:
        return self.missed + self.dropped


@dataclass(frozen=True, slots=True, kw_only=True)
class RecorderMetrics:
    """What was recorded; of a killed recorder, until its last report."""

    #: Files begun.
    parts: int = 0
    #: Octets written.
    octets: int = 0
    #: Failures to open or write a file.
    disk_faults: int = 0
    #: Key pictures that came too late: the units that waited were written without.
    late_keys: int = 0
    #: The newest file; null before anything was recorded.
    file: Newest[str] | None = None
    #: Whether it records now.
    recording: Newest[bool] = False
    #: Which cameras are recorded, and what all of them need.
    cameras: Newest[str] = ""
    #: Why nothing can be written; null if all is well.
    fault: Newest[str] | None = None
    #: What waits for the disk.
    waiting_octets: Newest[int] = 0
    channels: Mapping[str, RecordedChannel] = field(default_factory=dict)

    @property
    def messages(self) -> int:
        """How many are in the files."""
        return sum(channel.kept for channel in self.channels.values())

    @property
    def lost(self) -> int:
        """How many messages are not in the files."""
        return sum(channel.lost for channel in self.channels.values())


@dataclass(frozen=True, slots=True, kw_only=True)
class ReplayMetrics:
    """A process that sends again what was recorded."""

    #: Units or packets due before it was there; after a restart also those that it had sent.
    items_left_out: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class FoxgloveMetrics:
    """Clients of `--foxglove`."""

    #: Web sockets opened.
    connections: int = 0
    #: Requests refused, by reason.
    refused: Mapping[str, int] = field(default_factory=dict)
    #: Malformed messages of clients; each closed its socket.
    garbage: int = 0
    #: Services called.
    calls: int = 0
    #: HEVC units withheld from clients, because they refer to ones before that are missing or
    #: refused. The next key picture ends that.
    undecodable: int = 0
    #: By channel, over all clients.
    channels: Mapping[str, RecordedChannel] = field(default_factory=dict)
    #: Clients now.
    watching: Newest[int] = 0
    #: What waits for all clients; of each at most 4 MiB or 2 s, else the oldest is dropped.
    waiting_octets: Newest[int] = 0
    #: The age of the oldest.
    oldest_age_ns: Newest[int] = 0
