"""The process that writes snapshots of the displays as PNG files."""

from pathlib import Path

import cv2

from kontur_av.clock import NS_PER_S
from kontur_av.media import I420
from pipelines.media.figures import SnapshotFigures
from pipelines.media.snapshots import SnapshotSchedule
from pipelines.session.process import PATIENCE_NS, Context


def run_snapshots(context: Context) -> None:
    """Write each picture that `SnapshotSchedule` asks for."""
    assert context.snapshots is not None
    clock, probe = context.clock, context.probe
    schedule = SnapshotSchedule(
        context.topology, started_ns=context.started_ns, now_ns=clock.now_ns()
    )
    written = failed = 0
    context.on_flush(
        lambda: probe.tell(SnapshotFigures(snapshots=written, snapshots_failed=failed))
    )
    with context.open_bus() as bus:
        while not context.stopping:
            now_ns = clock.now_ns()
            context.tick(now_ns)
            schedule.handle_time(now_ns)
            while (snapshot := schedule.next_event()) is not None:
                # Join for one picture only, so that no writer publishes for this reader meanwhile.
                reader = bus.reader(snapshot.topic)
                reader.wait(NS_PER_S)
                lease = reader.latest()
                if lease is not None:
                    with lease:
                        picture = lease.video().data.copy()
                    for kept in _write(
                        context.snapshots, snapshot.name, picture, halves=snapshot.halves
                    ):
                        written += kept
                        failed += not kept
                reader.close()
            clock.sleep_until_ns(min(schedule.poll_timeout(), clock.now_ns() + PATIENCE_NS))


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
