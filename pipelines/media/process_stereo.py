"""The process that merges the pictures of the robot's two cameras into one."""

from kontur_av.clock import NS_PER_S
from kontur_av.sources.stereo import HALF, StereoPairer
from kontur_av.topics.bus import Lease
from pipelines.media.figures import StereoFigures
from pipelines.media.marking import StereoMerger
from pipelines.session.process import PATIENCE_NS, Context
from pipelines.session.setup.table import STEREO, STEREO_INPUTS
from pipelines.session.topology import HALVES_TOPIC


def run_stereo(context: Context) -> None:
    """Publish the left part of the left camera and the right part of the right one as one picture.

    Pairs are always counted, and merged only while the topic has a reader.
    """
    clock, video, topology = context.clock, context.setup.uplink_video, context.topology
    pairer = StereoPairer(period_ns=NS_PER_S // video.fps)
    merger = StereoMerger()
    context.on_flush(
        lambda: context.probe.tell(StereoFigures(paired=pairer.paired, single=pairer.single))
    )
    with context.open_bus() as bus:
        writer = bus.writer(
            topology.camera(STEREO).topic, max_octets=video.width * video.height * 3 // 2
        )
        halves = bus.writer(HALVES_TOPIC, max_octets=HALF.size, wake=False)
        readers = [bus.reader(topology.input(name).topic) for name in STEREO_INPUTS]
        # The pairer may use a camera's last picture again, so its lease is kept until the next.
        leases: list[Lease | None] = [None, None]

        def publish_pairs() -> None:
            while (pair := pairer.next_event()) is not None:
                halves.publish_octets(HALF.pack(pair.oldest_ns), pair.stamp)
                if not writer.has_readers():
                    continue
                loan = writer.loan_picture(video.width, video.height)
                merger.handle_pair(pair, loan.picture, clock.now_ns())
                loan.publish(pair.stamp)

        waiter = bus.waiter(readers)
        while not context.stopping:
            now_ns = clock.now_ns()
            context.tick(now_ns)
            due_ns = pairer.poll_timeout()
            waiter.wait(PATIENCE_NS if due_ns is None else min(PATIENCE_NS, due_ns - now_ns))
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
