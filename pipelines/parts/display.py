"""A segment's display and loudspeaker: where pictures and sounds come to their end.

Without a screen or a sound card this is where they would go next; the instant of taking them out
of shared memory counts as the instant of display.
"""

from collections.abc import Sequence

from pipelines.names import received_topic
from pipelines.process import PATIENCE_NS, Context
from pipelines.setup import VideoStream, VoiceStream

#: The source of a block of sound that had to be made up: heard, but never captured.
CONCEALED = "concealed"


def run_display(context: Context, *, streams: Sequence[VideoStream | VoiceStream]) -> None:
    """Show the newest picture and every block of sound of `streams`."""
    clock, probe = context.clock, context.probe
    with context.open_bus() as bus:
        readers = [
            bus.reader(
                received_topic(stream.name), depth=1 if isinstance(stream, VideoStream) else 8
            )
            for stream in streams
        ]
        displayed = [0] * len(streams)

        def fill() -> None:
            for stream, shown in zip(streams, displayed, strict=True):
                probe.total(f"{stream.name}.frames_displayed", shown)

        context.on_flush(fill)
        waiter = bus.waiter(readers)
        while not context.stopping:
            context.tick(clock.now_ns())
            waiter.wait(PATIENCE_NS)
            for index, reader in enumerate(readers):
                take = reader.latest if isinstance(streams[index], VideoStream) else reader.next
                while (lease := take()) is not None:
                    now_ns = clock.now_ns()
                    stamp = lease.stamp
                    lease.release()
                    if stamp.source == CONCEALED:
                        continue
                    displayed[index] += 1
                    series = f"shown.{streams[index].name}"
                    probe.row(series, stamp.sequence, stamp.capture_ns, now_ns)
        del waiter
