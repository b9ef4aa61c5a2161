"""An input's process: from its source into its topic."""

from kontur_av.media import CaptureStamp
from kontur_av.sources import open_audio, open_video
from kontur_av.sources.source import BLOCK_SAMPLES, AudioSource, VideoSource
from pipelines.names import input_topic
from pipelines.parts.robot_state import newest_state
from pipelines.process import PATIENCE_NS, Context
from pipelines.setup import VideoStream
from telepresence.world import audio_scenes, video_scenes


def run_camera(context: Context, *, name: str, stream: VideoStream) -> None:
    """Capture the pictures of the input `name` in the size and rate of `stream`."""
    clock = context.clock
    with context.open_bus() as bus:
        writer = bus.writer(input_topic(name), max_octets=stream.width * stream.height * 3 // 2)
        source = open_video(
            context.setup.source(name),
            name=name,
            width=stream.width,
            height=stream.height,
            fps=stream.fps,
            clock=clock,
            scenes=video_scenes(newest_state(bus)),
        )
        captured = _Captured(context, source)
        loan = writer.loan_picture(stream.width, stream.height)
        while not context.stopping:
            stamp = source.read(loan.picture, PATIENCE_NS)
            if stamp is not None:
                loan.publish(stamp)
                loan = writer.loan_picture(stream.width, stream.height)
                captured.count(stamp)
            context.tick(clock.now_ns())
        loan.give_back()
        source.close()


def run_microphone(context: Context, *, name: str) -> None:
    """Capture the sound of the input `name`, 20 ms a sample of the topic."""
    clock = context.clock
    with context.open_bus() as bus:
        writer = bus.writer(input_topic(name), max_octets=BLOCK_SAMPLES * 2)
        source = open_audio(
            context.setup.source(name),
            name=name,
            clock=clock,
            scenes=audio_scenes(newest_state(bus)),
        )
        captured = _Captured(context, source)
        while not context.stopping:
            frame = source.read(PATIENCE_NS)
            if frame is not None:
                writer.publish_audio(frame)
                captured.count(frame.stamp)
            context.tick(clock.now_ns())
        source.close()


class _Captured:
    """Counts what a source gives, and tells it with the faults that the source has survived."""

    def __init__(self, context: Context, source: VideoSource | AudioSource) -> None:
        self._probe = context.probe
        self._source = source
        self._captured = 0
        self._last_ns: int | None = None
        context.on_flush(self._fill)

    def count(self, stamp: CaptureStamp) -> None:
        self._captured += 1
        self._last_ns = stamp.capture_ns

    def _fill(self) -> None:
        self._probe.total("captured", self._captured)
        self._probe.total("source_faults", self._source.faults)
        if self._last_ns is not None:
            self._probe.gauge("captured_ns", self._last_ns)
        if self._source.last_fault:
            self._probe.gauge("source_fault", self._source.last_fault)
