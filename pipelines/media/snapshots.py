"""When snapshots of the displays are due, and what they are called."""

from typing import NamedTuple

from kontur_av.clock import NS_PER_S
from pipelines.session.setup.table import STEREO
from pipelines.session.topology import Segment, Topology, VideoRow

_FIRST_NS = NS_PER_S
_SHORTEST_INTERVAL_NS = 3 * NS_PER_S
#: The interval is this part of the session's age: thirty snapshots in an hour, 45 in a day.
_INTERVAL_SHARE = 4


class Snapshot(NamedTuple):
    """A picture to keep: its file's name without suffix, its topic, and whether to keep its halves
    as files of their own, too."""

    name: str
    topic: str
    halves: bool


class SnapshotSchedule:
    """Asks for a picture of each display and of the stereo merge, at growing intervals. A core.

    Call `handle_time` at `poll_timeout`, then drain `next_event`.

    started_ns: when the session began. The instants are the same for every life of the process, so
    a restart repeats none. A name ends with the second of the session at which it was due.
    """

    def __init__(self, topology: Topology, *, started_ns: int, now_ns: int) -> None:
        self._started_ns = started_ns
        self._topics = {
            f"{row.direction.receiver.value}-{row.name}": row.displayed_topic
            for row in topology.media_streams
            if isinstance(row, VideoRow) and topology.runs(row.display)
        }
        self._stereo = f"{Segment.GROUND.value}-{STEREO}"
        if STEREO in topology.setup.cameras and Segment.GROUND in topology.segments:
            self._topics[self._stereo] = topology.camera(STEREO).topic
        self._due_ns = _next_ns(now_ns - started_ns)
        self._snapshots: list[Snapshot] = []

    def poll_timeout(self) -> int:
        """Return when the next snapshots are due."""
        return self._started_ns + self._due_ns

    def handle_time(self, now_ns: int) -> None:
        """Ask for the snapshots that are due; those that were missed are left out."""
        if now_ns < self.poll_timeout():
            return
        second = f"{self._due_ns // NS_PER_S:04d}s"
        self._snapshots = [
            Snapshot(f"{name}-{second}", topic, halves=name == self._stereo)
            for name, topic in reversed(self._topics.items())
        ]
        self._due_ns = _next_ns(now_ns - self._started_ns)

    def next_event(self) -> Snapshot | None:
        return self._snapshots.pop() if self._snapshots else None


def _next_ns(session_ns: int) -> int:
    """Return when the next snapshot is due after `session_ns`, both since the session's start."""
    due_ns = _FIRST_NS
    while due_ns <= session_ns:
        due_ns += max(_SHORTEST_INTERVAL_NS, due_ns // _INTERVAL_SHARE)
    return due_ns
