"""A segment's display and loudspeaker: where pictures and sounds come to their end.

Without a screen or a sound card this is where they would go next; the instant of taking them out
of shared memory counts as the instant of display.
"""

from collections.abc import Sequence

from pipelines.cores.showing import Showing
from pipelines.names import CONCEALED as CONCEALED
from pipelines.names import received_topic
from pipelines.process import PATIENCE_NS, Context
from pipelines.setup import VideoStream, VoiceStream


def run_display(context: Context, *, streams: Sequence[VideoStream | VoiceStream]) -> None:
    """Show the newest picture and every block of sound of `streams`."""
    clock = context.clock
    showing = Showing([stream.name for stream in streams], context.probe)
    context.on_flush(showing.tell)
    with context.open_bus() as bus:
        readers = [
            bus.reader(
                received_topic(stream.name), depth=1 if isinstance(stream, VideoStream) else 8
            )
            for stream in streams
        ]
        waiter = bus.waiter(readers)
        while not context.stopping:
            context.tick(clock.now_ns())
            waiter.wait(PATIENCE_NS)
            for stream, reader in zip(streams, readers, strict=True):
                take = reader.latest if isinstance(stream, VideoStream) else reader.next
                while (lease := take()) is not None:
                    now_ns = clock.now_ns()
                    stamp = lease.stamp
                    lease.release()
                    showing.handle_shown(stream.name, stamp, now_ns)
        del waiter
