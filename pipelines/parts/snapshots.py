"""The process that keeps what each display shows as PNG files, now and then."""

from pathlib import Path

import cv2

from kontur_av.clock import NS_PER_S
from kontur_av.media import I420
from pipelines.names import STEREO_TOPIC, received_topic
from pipelines.process import PATIENCE_NS, Context, Segment
from pipelines.setup import STEREO

_INTERVAL_NS = 4 * NS_PER_S
_FIRST_NS = 3 * NS_PER_S


def run_snapshots(context: Context) -> None:
    """Every few seconds a picture of each display, of the stereo merge and of its halves."""
    assert context.snapshots is not None
    clock, setup, probe = context.clock, context.setup, context.probe
    topics = {f"{Segment.SPACE.value}-uplink_video": received_topic("uplink_video")}
    if setup.downlink_video:
        topics[f"{Segment.GROUND.value}-downlink_video"] = received_topic("downlink_video")
    if STEREO in setup.cameras:
        topics[f"{Segment.GROUND.value}-stereo"] = STEREO_TOPIC
    written = 0
    context.on_flush(lambda: probe.total("snapshots", written))
    begun_ns = due_ns = clock.now_ns()
    due_ns += _FIRST_NS
    with context.open_bus() as bus:
        while not context.stopping:
            now_ns = clock.now_ns()
            context.tick(now_ns)
            if now_ns < due_ns:
                clock.sleep_until_ns(min(due_ns, now_ns + PATIENCE_NS))
                continue
            due_ns = now_ns + _INTERVAL_NS
            for name, topic in topics.items():
                # Joined for one picture only, so that nobody publishes for this reader between.
                reader = bus.reader(topic)
                reader.wait(NS_PER_S)
                lease = reader.latest()
                if lease is not None:
                    with lease:
                        picture = lease.video().data.copy()
                    seconds = round((now_ns - begun_ns) / NS_PER_S)
                    written += _write(context.snapshots, f"{name}-{seconds:04d}s", picture)
                reader.close()


def _write(directory: Path, name: str, picture: I420) -> int:
    image = cv2.cvtColor(picture, cv2.COLOR_YUV2BGR_I420)
    parts = {"": image}
    if "stereo" in name:
        middle = image.shape[1] // 2
        parts |= {"-left-half": image[:, :middle], "-right-half": image[:, middle:]}
    for suffix, part in parts.items():
        cv2.imwrite(str(directory / f"{name}{suffix}.png"), part)
    return len(parts)
