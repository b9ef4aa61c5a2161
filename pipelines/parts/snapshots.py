"""The process that writes snapshots of the displays as PNG files."""

from pathlib import Path

import cv2

from kontur_av.clock import NS_PER_S
from kontur_av.media import I420
from pipelines.cores.figures import SnapshotCounters
from pipelines.runtime.process import PATIENCE_NS, Context
from pipelines.setup.table import STEREO
from pipelines.topology import Segment, VideoRow

_FIRST_NS = NS_PER_S
_SHORTEST_INTERVAL_NS = 3 * NS_PER_S
#: The interval is this part of the session's age: thirty snapshots in an hour, 45 in a day.
_INTERVAL_SHARE = 4


def next_snapshot_ns(session_ns: int) -> int:
    """Return when the next snapshot is due after `session_ns`, both since the session's start.

    The instants are the same for every life of the process, so a restart repeats none.
    """
    due_ns = _FIRST_NS
    while due_ns <= session_ns:
        due_ns += max(_SHORTEST_INTERVAL_NS, due_ns // _INTERVAL_SHARE)
    return due_ns


def run_snapshots(context: Context) -> None:
    """Write a picture of each display, of the stereo merge and of its halves, at growing intervals.

    A file's name ends with the second of the session at which it was due.
    """
    assert context.snapshots is not None
    clock, setup, probe = context.clock, context.setup, context.probe
    topology = context.topology
    topics = {
        f"{row.direction.receiver.value}-{row.name}": row.displayed_topic
        for row in topology.media_streams
        if isinstance(row, VideoRow)
    }
    stereo = f"{Segment.GROUND.value}-{STEREO}"
    if STEREO in setup.cameras:
        topics[stereo] = topology.camera(STEREO).topic
    written = failed = 0

    def fill() -> None:
        probe.count(SnapshotCounters(snapshots=written, snapshots_failed=failed))

    context.on_flush(fill)
    begun_ns = context.started_ns
    due_ns = next_snapshot_ns(clock.now_ns() - begun_ns)
    with context.open_bus() as bus:
        while not context.stopping:
            now_ns = clock.now_ns()
            context.tick(now_ns)
            if now_ns - begun_ns < due_ns:
                clock.sleep_until_ns(min(begun_ns + due_ns, now_ns + PATIENCE_NS))
                continue
            instant = f"{due_ns // NS_PER_S:04d}s"
            due_ns = next_snapshot_ns(now_ns - begun_ns)
            for name, topic in topics.items():
                # Join for one picture only, so that no writer publishes for this reader meanwhile.
                reader = bus.reader(topic)
                reader.wait(NS_PER_S)
                lease = reader.latest()
                if lease is not None:
                    with lease:
                        picture = lease.video().data.copy()
                    for kept in _write(
                        context.snapshots, f"{name}-{instant}", picture, halves=name == stereo
                    ):
                        written += kept
                        failed += not kept
                reader.close()


def _write(directory: Path, name: str, picture: I420, *, halves: bool) -> list[bool]:
    """Write the files, and return for each whether it was written: a full disk ends no session."""
    image = cv2.cvtColor(picture, cv2.COLOR_YUV2BGR_I420)
    parts = {"": image}
    if halves:
        middle = image.shape[1] // 2
        parts |= {"-left-half": image[:, :middle], "-right-half": image[:, middle:]}
    return [
        cv2.imwrite(str(directory / f"{name}{suffix}.png"), part) for suffix, part in parts.items()
    ]
