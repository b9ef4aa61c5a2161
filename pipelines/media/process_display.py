"""A segment's display and loudspeaker, where pictures and sounds end.

There is no screen: the instant of reading from shared memory counts as that of display; a
loudspeaker has sound heard later (`LoudspeakerCounts`). The picture that a screen would show, with
a mark if it is stale, is published as a topic. `Showing` decides what is drawn when.
"""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ConfigError
from kontur_av.media import I420
from kontur_av.streams.lipsync import Lag
from kontur_av.streams.loudspeaker import Loudspeaker
from kontur_av.streams.voice_receiver import LoudspeakerCounts
from kontur_av.topics.bus import Lease, TopicBus
from pipelines.media.marking import mark_stale
from pipelines.media.media_metrics import SnapshotMetrics
from pipelines.media.showing import OPERATORS, Showing, SnapshotSchedule, Watching
from pipelines.session.process import TIMEOUT_NS, Context
from pipelines.session.setup.table import VideoStream, VoiceStream
from pipelines.session.topic import Topic
from pipelines.session.topic_ends import TopicWriter
from pipelines.session.topology.topics import displayed_topic, received_topic


def run_snapshots(context: Context) -> None:
    """Write each picture that `SnapshotSchedule` asks for."""
    assert context.snapshots is not None
    clock, probe = context.clock, context.probe
    schedule = SnapshotSchedule(
        context.topology, started_ns=context.started_ns, now_ns=clock.now_ns()
    )
    written = failed = 0
    context.on_flush(
        lambda: probe.publish(SnapshotMetrics(snapshots=written, snapshots_failed=failed))
    )
    with context.open_bus() as bus:
        while not context.stopping:
            now_ns = clock.now_ns()
            context.tick(now_ns)
            schedule.handle_time(now_ns)
            while not context.stopping and (snapshot := schedule.next_event()) is not None:
                # Join for one picture only, so that no writer publishes for this reader meanwhile.
                reader = bus.reader(snapshot.topic)
                until_ns = clock.now_ns() + NS_PER_S
                # At the end of a session there may be no writer left.
                while not context.stopping and not reader.wait(TIMEOUT_NS):
                    if clock.now_ns() >= until_ns:
                        break
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
            clock.sleep_until_ns(min(schedule.poll_timeout(), clock.now_ns() + TIMEOUT_NS))


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


class _Picture:
    """The displayed picture of one video stream, published as a topic while there is a reader."""

    def __init__(self, bus: TopicBus, stream: VideoStream, lag_topic: Topic[Lag] | None) -> None:
        octets = stream.width * stream.height * 3 // 2
        self._writer = bus.writer(displayed_topic(stream.name), max_octets=octets)
        # The voice receiver polls it for lip-sync.
        self._lag = None if lag_topic is None else TopicWriter(bus, lag_topic)
        self._lease: Lease | None = None

    def handle_picture(self, lease: Lease, now_ns: int) -> None:
        """The newest picture; it is kept until the next one comes."""
        stamp = lease.stamp
        if self._lag is not None:
            self._lag.publish(Lag(now_ns, now_ns - stamp.capture_ns), stamp.capture_ns)
        if self._lease is not None:
            self._lease.release()
        self._lease = lease

    def draw(self, stale_ns: int | None) -> None:
        """Publish the picture; stale_ns: the age for the mark of a stale one, else None."""
        assert self._lease is not None
        if not self._writer.has_readers():
            return
        frame = self._lease.video()
        loan = self._writer.loan_picture(frame.width, frame.height)
        np.copyto(loan.picture, frame.data)
        if stale_ns is not None:
            mark_stale(loan.picture, stale_ns)
        loan.publish(frame.stamp)


def _loudspeaker(context: Context, spec: str | None) -> Loudspeaker | None:
    """Return what plays; why it cannot be had is told, and ends nothing."""
    if spec is None:
        return None
    try:
        speaker = Loudspeaker(spec, context.clock)
    except ConfigError as error:
        context.probe.publish(LoudspeakerCounts(play_fault=str(error)))
        return None
    context.on_flush(lambda: context.probe.publish(speaker.counts))
    return speaker


def run_display(
    context: Context,
    *,
    streams: Sequence[VideoStream | VoiceStream],
    for_lip_sync: bool = True,
    playback: str | None = None,
) -> None:
    """Show the newest picture and every block of sound of `streams`.

    playback: the loudspeaker that has the sound heard, as of `Loudspeaker`.
    for_lip_sync: tell the voices' receivers how late the pictures are shown.
    """
    clock = context.clock
    showing = Showing(context.setup, streams, context.probe)
    watching, watched = Watching(context.probe), {stream.name for stream in streams} & OPERATORS
    context.on_flush(lambda: showing.publish(clock.now_ns()))
    speaker = _loudspeaker(context, playback)
    with context.open_bus() as bus:
        readers = [
            bus.reader(
                received_topic(stream.name), depth=1 if isinstance(stream, VideoStream) else 8
            )
            for stream in streams
        ]
        pictures = {
            stream.name: _Picture(
                bus, stream, context.topology.video(stream.name).lag_topic if for_lip_sync else None
            )
            for stream in streams
            if isinstance(stream, VideoStream)
        }
        waiter = bus.waiter(readers)
        while not context.stopping:
            now_ns = clock.now_ns()
            context.tick(now_ns)
            due_ns = showing.poll_timeout()
            wait_ns = TIMEOUT_NS if due_ns is None else min(TIMEOUT_NS, due_ns - now_ns)
            waiter.wait(max(0, wait_ns))
            for stream, reader in zip(streams, readers, strict=True):
                picture = pictures.get(stream.name)
                take = reader.next if picture is None else reader.latest
                while (lease := take()) is not None:
                    now_ns = clock.now_ns()
                    showing.handle_shown(stream.name, lease.stamp, now_ns)
                    name, stamp, watches = stream.name, lease.stamp, stream.name in watched
                    if picture is None:
                        if speaker is not None:
                            speaker.play(lease.audio().samples)
                        if watches:
                            watching.handle_sound(name, lease.audio().samples, stamp, now_ns)
                        lease.release()
                        continue
                    if watches:
                        watching.handle_picture(name, lease.video().data, stamp, now_ns)
                    picture.handle_picture(lease, now_ns)
            showing.handle_time(clock.now_ns())
            while (drawing := showing.next_event()) is not None:
                pictures[drawing.stream].draw(drawing.stale_ns)
        del waiter
    if speaker is not None:
        speaker.close()
