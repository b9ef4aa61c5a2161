"""A segment's display and loudspeaker, where pictures and sounds end.

There is no screen and no sound card: the instant of reading from shared memory counts as the
instant of display. The picture that a screen would show, with a mark if it is stale, is published
as a topic.
"""

from collections.abc import Sequence

import numpy as np

from kontur_av.clock import NS_PER_MS
from kontur_av.streams.lipsync import LAG
from kontur_av.streams.staleness import Staleness
from kontur_av.topics.bus import Lease, TopicBus
from pipelines.cores.showing import Showing
from pipelines.cores.watching import OPERATORS, Watching
from pipelines.parts.marking import mark_stale
from pipelines.runtime.process import PATIENCE_NS, Context
from pipelines.setup.table import VideoStream, VoiceStream
from pipelines.topology import VideoRow

#: How often the age on a stale picture is drawn anew.
_REDRAW_NS = 100 * NS_PER_MS


class _Screen:
    """The displayed picture of one video stream, published as a topic while there is a reader.

    A new reader gets the next picture, or the next mark, which is drawn every `_REDRAW_NS`.
    """

    def __init__(
        self, bus: TopicBus, row: VideoRow, stream: VideoStream, staleness: Staleness
    ) -> None:
        octets = stream.width * stream.height * 3 // 2
        self._writer = bus.writer(row.displayed_topic, max_octets=octets)
        # The voice receiver polls it for lip-sync.
        self._lag = bus.writer(row.lag_topic, max_octets=LAG.size, wake=False)
        self._staleness = staleness
        self._lease: Lease | None = None
        self._drawn_ns = 0

    def handle_picture(self, lease: Lease, now_ns: int) -> None:
        """The newest picture; it is kept until the next one comes."""
        stamp = lease.stamp
        self._lag.publish_octets(LAG.pack(now_ns, now_ns - stamp.capture_ns), stamp)
        previous, self._lease = self._lease, lease
        self._draw(now_ns)
        if previous is not None:
            previous.release()

    def due_ns(self) -> int | None:
        """Return when to draw the mark next; None while there is no picture."""
        stale_ns = self._staleness.stale_from_ns()
        return None if stale_ns is None else max(stale_ns, self._drawn_ns + _REDRAW_NS)

    def handle_time(self, now_ns: int) -> None:
        """Draw the mark if it is due."""
        due_ns = self.due_ns()
        if due_ns is not None and now_ns >= due_ns:
            self._draw(now_ns)

    def _draw(self, now_ns: int) -> None:
        assert self._lease is not None
        self._drawn_ns = now_ns
        if not self._writer.has_readers():
            return
        frame = self._lease.video()
        loan = self._writer.loan_picture(frame.width, frame.height)
        np.copyto(loan.picture, frame.data)
        stale_ns = self._staleness.stale_from_ns()
        if stale_ns is not None and now_ns >= stale_ns:
            mark_stale(loan.picture, now_ns - frame.stamp.capture_ns)
        loan.publish(frame.stamp)


def run_display(context: Context, *, streams: Sequence[VideoStream | VoiceStream]) -> None:
    """Show the newest picture and every block of sound of `streams`."""
    clock = context.clock
    showing = Showing(context.setup, streams, context.probe)
    watching, watched = Watching(context.probe), {stream.name for stream in streams} & OPERATORS
    context.on_flush(lambda: showing.tell(clock.now_ns()))
    with context.open_bus() as bus:
        readers = [
            bus.reader(
                context.topology.media(stream.name).received_topic,
                depth=1 if isinstance(stream, VideoStream) else 8,
            )
            for stream in streams
        ]
        screens = {
            stream.name: _Screen(
                bus, context.topology.video(stream.name), stream, showing.staleness[stream.name]
            )
            for stream in streams
            if isinstance(stream, VideoStream)
        }
        waiter = bus.waiter(readers)
        while not context.stopping:
            now_ns = clock.now_ns()
            context.tick(now_ns)
            due = [due_ns for screen in screens.values() if (due_ns := screen.due_ns()) is not None]
            waiter.wait(min([PATIENCE_NS, *(max(0, due_ns - now_ns) for due_ns in due)]))
            for stream, reader in zip(streams, readers, strict=True):
                screen = screens.get(stream.name)
                take = reader.next if screen is None else reader.latest
                while (lease := take()) is not None:
                    now_ns = clock.now_ns()
                    showing.handle_shown(stream.name, lease.stamp, now_ns)
                    if stream.name in watched:
                        watching.handle_sample(stream.name, lease, now_ns)
                    if screen is None:
                        lease.release()
                    else:
                        screen.handle_picture(lease, now_ns)
            now_ns = clock.now_ns()
            for screen in screens.values():
                screen.handle_time(now_ns)
        del waiter
