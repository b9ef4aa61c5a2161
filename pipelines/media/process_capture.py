"""The processes of an input, from its source or a browser page, and of a composed camera."""

import numpy as np

from kontur_av.clock import NS_PER_MS
from kontur_av.media import I420, CaptureStamp
from kontur_av.sources import SceneVideo, open_audio, open_video
from kontur_av.sources.live import LiveCapture
from kontur_av.sources.source import BLOCK_NS, BLOCK_SAMPLES, TOPIC, PageAudio, PageVideo
from kontur_av.sources.stereo import PicturePairer
from kontur_av.sources.user import UserSource
from kontur_av.topics.bus import Lease, Reader, TopicBus
from pipelines.media.following import TIP_EVERY_NS
from pipelines.media.marking import PictureComposer
from pipelines.media.media_metrics import CompositionMetrics
from pipelines.media.taking_over import Capturing, Previewing, Takeover, preview_size
from pipelines.session.mission_messages import MISSION_LEDS_TOPIC
from pipelines.session.process import TIMEOUT_NS, Context
from pipelines.session.setup.table import VideoStream
from pipelines.session.topic_ends import TopicReader, TopicWriter, newest_state
from pipelines.session.topology.rows import InputRow
from pipelines.session.training import TRAINER_TOPIC
from telepresence.world import audio_scenes, video_scenes


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


#: How long to wait for the input's own source while a page has the input. It is read on, so that it
#: neither stalls nor gives a burst of old pictures afterwards.
_ASIDE_NS = NS_PER_MS
#: Unread blocks of a page; the oldest are dropped.
_BLOCKS = 8
_BLOCK_OCTETS = 2 * BLOCK_SAMPLES


def run_camera(context: Context, *, name: str, stream: VideoStream) -> None:
    """Capture the pictures of the input `name` in the size and rate of `stream`.

    A built-in scene always counts its pictures, and draws them only while somebody looks. Pictures
    of browser pages are taken in place of the source's. There are none while a trainer's exercise
    says so. A scene has what the LED panel shows, where there is one.
    """
    with context.open_bus() as bus:
        camera = _Camera(context, bus, name, stream)
        while not context.stopping:
            camera.handle_next()
            context.tick(context.clock.now_ns())
        camera.close()


def run_microphone(context: Context, *, name: str) -> None:
    """Capture the sound of the input `name`, 20 ms a sample of the topic.

    Sound of browser pages is taken in place of the source's.
    """
    with context.open_bus() as bus:
        microphone = _Microphone(context, bus, name)
        while not context.stopping:
            microphone.handle_next()
            context.tick(context.clock.now_ns())
        microphone.close()


class _Camera:
    """A camera: its source, a page in place of it, and what it writes."""

    def __init__(self, context: Context, bus: TopicBus, name: str, stream: VideoStream) -> None:
        self._clock = context.clock
        row = context.topology.input(name)
        reads = context.topology.reads(row.process)
        leds = MISSION_LEDS_TOPIC in reads
        self._size = stream.width, stream.height
        self._period_ns = stream.period_ns
        self._writer = bus.writer(row.topic, max_octets=_octets(*self._size))
        self._source = open_video(
            context.setup.source(name),
            name=name,
            width=stream.width,
            height=stream.height,
            fps=stream.fps,
            clock=context.clock,
            scenes=video_scenes(newest_state(bus, leds=leds)),
            wait=False,
        )
        # Drawing is most of a scene's work, and needless without a reader.
        self._scene = self._source if isinstance(self._source, SceneVideo) else None
        self._small = preview_size(*self._size)
        self._preview = bus.writer(row.preview_topic, max_octets=_octets(*self._small))
        self._previewing = Previewing()
        self._page = bus.reader(row.page_topic) if _may_be_filled(context, row) else None
        self._takeover = Takeover.of_pictures(name)
        self._capturing = Capturing(context.probe)
        context.on_flush(self._report)
        #: Where a user's class sees the robot's tip, in cameras that begin with this input.
        self._tips, self._tip_due_ns = TopicWriter(bus, row.tip_topic), 0
        self._cameras = [
            camera.name
            for camera in context.topology.cameras
            if camera.inputs[0] == name
            and (camera.composition is None or camera.composition.layout != "beside")
        ]
        self._name = name
        self._exercises = TopicReader(bus, TRAINER_TOPIC) if TRAINER_TOPIC in reads else None
        self._lost_until_ns = 0
        self._loan = self._writer.loan_picture(*self._size)

    def handle_next(self) -> None:
        """Capture the next picture, or wait for it at most `TIMEOUT_NS`."""
        exercises = None if self._exercises is None else self._exercises.changed()
        if exercises is not None:
            self._lost_until_ns = exercises.cameras_ns.get(self._name, 0)
        page, now_ns = self._page, self._clock.now_ns()
        if page is not None and _waits_for_page(self._source, self._takeover, now_ns):
            page.wait(_timeout_ns(self._takeover, now_ns, self._period_ns))
            self._take_from(page)
            self._read_aside()
            return
        if page is not None and page.has_new():
            self._take_from(page)
            return
        if self._scene is not None and not self._wanted():
            self._capture(self._scene.skip(TIMEOUT_NS, self._wanted), drawn=False)
        else:
            self._capture(self._source.read(self._loan.picture, TIMEOUT_NS), drawn=True)
            self._publish_tip(now_ns)

    def close(self) -> None:
        self._loan.give_back()
        self._source.close()

    def _take_from(self, page: Reader) -> None:
        lease = page.latest()
        if lease is None:
            return
        with lease:
            if (lease.width, lease.height) != self._size:
                self._takeover.handle_unfit()
                return
            stamp = self._takeover.handle_page(lease.stamp, self._clock.now_ns())
            drawn = stamp is not None and self._wanted()
            if drawn:
                np.copyto(self._loan.picture, lease.video().data)
        if stamp is not None:
            self._publish(stamp, drawn=drawn)

    def _read_aside(self) -> None:
        if self._scene is not None:
            self._scene.skip(0, lambda: False)
        elif not isinstance(self._source, PageVideo):
            self._source.read(self._loan.picture, _ASIDE_NS)

    def _capture(self, stamp: CaptureStamp | None, *, drawn: bool) -> None:
        """The own source gave a picture. drawn: it is in the loan."""
        if stamp is not None:
            stamp = self._takeover.handle_own(stamp, self._clock.now_ns())
        if stamp is not None:
            self._publish(stamp, drawn=drawn)

    def _publish(self, stamp: CaptureStamp, *, drawn: bool) -> None:
        if stamp.capture_ns < self._lost_until_ns:
            return
        if drawn:
            # Before the loan is gone.
            self._publish_preview(self._loan.picture, stamp)
            self._loan.publish(stamp)
            self._loan = self._writer.loan_picture(*self._size)
        self._capturing.handle_captured(stamp)

    def _publish_preview(self, picture: I420, stamp: CaptureStamp) -> None:
        now_ns = self._clock.now_ns()
        if not (self._previewing.due(now_ns) and self._preview.has_readers()):
            return
        from kontur_av.codecs.scaling import reduce

        self._previewing.handle_preview(now_ns)
        loan = self._preview.loan_picture(*self._small)
        reduce(picture, loan.picture)
        loan.publish(stamp)

    def _publish_tip(self, now_ns: int) -> None:
        if now_ns < self._tip_due_ns or not isinstance(self._source, UserSource):
            return
        self._tip_due_ns = now_ns + TIP_EVERY_NS
        if self._tips.has_readers() and (tip := self._source.tip()) is not None:
            self._tips.publish(dict.fromkeys(self._cameras, tip), now_ns)

    def _wanted(self) -> bool:
        return self._writer.has_readers() or (
            self._preview.has_readers() and self._previewing.due(self._clock.now_ns())
        )

    def _report(self) -> None:
        source = self._source
        takeover = None if self._page is None else self._takeover
        dated_by = source.dated_by if isinstance(source, LiveCapture) else None
        self._capturing.publish(source.faults, source.last_fault, takeover, dated_by)


class _Microphone:
    """A microphone: its source, a page in place of it, and what it writes."""

    def __init__(self, context: Context, bus: TopicBus, name: str) -> None:
        self._clock = context.clock
        row = context.topology.input(name)
        self._writer = bus.writer(row.topic, max_octets=_BLOCK_OCTETS)
        self._source = open_audio(
            context.setup.source(name),
            name=name,
            clock=context.clock,
            scenes=audio_scenes(newest_state(bus)),
        )
        self._page = None
        if _may_be_filled(context, row):
            self._page = bus.reader(row.page_topic, depth=_BLOCKS)
        self._takeover = Takeover.of_sound(name)
        self._capturing = Capturing(context.probe)
        context.on_flush(self._report)

    def handle_next(self) -> None:
        """Capture the next block, or wait for it at most `TIMEOUT_NS`."""
        page, now_ns = self._page, self._clock.now_ns()
        if page is not None and _waits_for_page(self._source, self._takeover, now_ns):
            page.wait(_timeout_ns(self._takeover, now_ns, BLOCK_NS))
            self._take_from(page)
            self._read_aside()
            return
        frame = self._source.read(TIMEOUT_NS)
        if frame is not None:
            stamp = self._takeover.handle_own(frame.stamp, self._clock.now_ns())
            if stamp is not None:
                self._publish(frame.samples.tobytes(), stamp)
        if page is not None and page.has_new():
            self._take_from(page)

    def close(self) -> None:
        self._source.close()

    def _take_from(self, page: Reader) -> None:
        while (lease := page.next()) is not None:
            with lease:
                stamp, samples = lease.stamp, lease.octets()
            if len(samples) != _BLOCK_OCTETS:
                self._takeover.handle_unfit()
                continue
            taken = self._takeover.handle_page(stamp, self._clock.now_ns())
            if taken is not None:
                self._publish(samples, taken)

    def _read_aside(self) -> None:
        if not isinstance(self._source, PageAudio):
            while self._source.read(0) is not None:
                pass

    def _publish(self, samples: bytes, stamp: CaptureStamp) -> None:
        self._writer.publish_octets(samples, stamp)
        self._capturing.handle_captured(stamp)

    def _report(self) -> None:
        source = self._source
        takeover = None if self._page is None else self._takeover
        self._capturing.publish(source.faults, source.last_fault, takeover)


def _may_be_filled(context: Context, row: InputRow) -> bool:
    """Whether a page or a joined program may give what the input takes."""
    by_page = row.page_topic in context.topology.reads(row.process)
    return by_page or context.setup.source(row.name) == TOPIC


def _waits_for_page(source: object, takeover: Takeover, now_ns: int) -> bool:
    """Whether the next picture or block is to come from a page."""
    return takeover.live(now_ns) or isinstance(source, PageVideo | PageAudio)


def _timeout_ns(takeover: Takeover, now_ns: int, period_ns: int) -> int:
    """How long to wait for a page.

    While one is live, one period: the own source must be read aside as often as it captures.
    """
    until_ns = takeover.poll_timeout()
    return TIMEOUT_NS if until_ns is None else max(0, min(period_ns, until_ns - now_ns))


def _octets(width: int, height: int) -> int:
    return width * height * 3 // 2
