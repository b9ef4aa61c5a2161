"""The process that composes the pictures of two cameras."""

from kontur_av.sources.stereo import PicturePairer
from kontur_av.topics.bus import Lease
from pipelines.media.composing import PictureComposer
from pipelines.media.media_metrics import CompositionMetrics
from pipelines.session.process import TIMEOUT_NS, Context
from pipelines.session.topic_ends import TopicWriter


def run_composing(context: Context, *, camera: str) -> None:
    """Publish the pictures of two inputs as one.

    Pairs are always counted, and composed only while the topic has a reader.
    """
    clock, video, topology = context.clock, context.setup.uplink_video, context.topology
    row = topology.camera(camera)
    assert row.composition is not None
    pairer = PicturePairer(period_ns=video.period_ns, name=camera)
    composer = PictureComposer(row.composition)
    context.on_flush(
        lambda: context.probe.publish(
            CompositionMetrics(paired=pairer.paired, single=pairer.single)
        )
    )
    with context.open_bus() as bus:
        writer = bus.writer(row.topic, max_octets=video.width * video.height * 3 // 2)
        oldest = TopicWriter(bus, row.oldest_topic)
        readers = [bus.reader(topology.input(name).topic) for name in row.inputs]
        # The pairer may use a camera's last picture again, so its lease is kept until the next.
        leases: list[Lease | None] = [None, None]

        def publish_pairs() -> None:
            while (pair := pairer.next_event()) is not None:
                oldest.publish(pair.oldest_ns, pair.stamp.capture_ns)
                if not writer.has_readers():
                    continue
                loan = writer.loan_picture(video.width, video.height)
                composer.handle_pair(pair, loan.picture, clock.now_ns())
                loan.publish(pair.stamp)

        waiter = bus.waiter(readers)
        while not context.stopping:
            now_ns = clock.now_ns()
            context.tick(now_ns)
            due_ns = pairer.poll_timeout()
            waiter.wait(TIMEOUT_NS if due_ns is None else min(TIMEOUT_NS, due_ns - now_ns))
            for side, reader in enumerate(readers):
                lease = reader.latest()
                if lease is None:
                    continue
                handle = pairer.handle_right if side else pairer.handle_left
                handle(lease.video(), clock.now_ns())
                # Publish before the release of the previous picture, which a pair may still use.
                publish_pairs()
                previous, leases[side] = leases[side], lease
                if previous is not None:
                    previous.release()
            pairer.handle_timeout(clock.now_ns())
            publish_pairs()
        del waiter
