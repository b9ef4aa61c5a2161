"""The process of `--frames`: copies of the radio link's frames, one a datagram."""

from kontur_av.clock import NS_PER_MS
from kontur_av.topics.bus import Reader
from pipelines.link.frame_batch import unpack_frames
from pipelines.packets.figures import FrameFigures
from pipelines.session.datagrams import LOOPBACK, Address, Outlet, is_loopback, outlet
from pipelines.session.process import Context
from pipelines.session.rows import SampleNumbers
from pipelines.session.setup.segments import Direction
from pipelines.session.topology import FRAMES

#: Samples that wait, of 20 ms each; the oldest goes.
_DEPTH = 32
#: Writers of frames wake nobody.
_WAKE_NS = 20 * NS_PER_MS


def run_frames(context: Context, address: Address) -> None:
    """Send the downlink's frames to `address`, and the uplink's to the port after it."""
    clock, segment = context.clock, context.topology.process(FRAMES).segment
    assert segment is not None
    host, port = address
    bind = LOOPBACK if is_loopback(host) else ""
    with context.open_bus() as bus:
        ways = {
            way: FrameCopies(
                bus.reader(topic, depth=_DEPTH),
                outlet(bind, (host, port + (way is Direction.UPLINK))),
            )
            for way, topic in context.topology.frame_topics(segment).items()
        }

        def fill() -> None:
            context.probe.tell(
                FrameFigures(
                    copied={way.value: one.copied for way, one in ways.items()},
                    copies_missed=sum(one.missed for one in ways.values()),
                    copies_unsent=sum(one.to.failed for one in ways.values()),
                )
            )

        context.on_flush(fill)
        while not context.stopping:
            context.tick(clock.now_ns())
            for one in ways.values():
                one.copy()
            clock.sleep_until_ns(clock.now_ns() + _WAKE_NS)


class FrameCopies:
    """One direction of the link: where its frames come from, and where they go."""

    def __init__(self, reader: Reader, to: Outlet) -> None:
        self._reader, self.to = reader, to
        self.copied = self.missed = 0
        self._numbers = SampleNumbers()

    def copy(self) -> None:
        """Send on what waits; then the other direction has its turn."""
        for _ in range(_DEPTH):
            if (lease := self._reader.next()) is None:
                return
            with lease:
                sequence, octets = lease.stamp.sequence, lease.octets()
            self.missed += self._numbers.handle_sample("", sequence)
            for _, frame in unpack_frames(octets):
                self.to.send(frame)
                self.copied += 1
