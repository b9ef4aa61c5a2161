"""The process of an input: from its source into its topic."""

from kontur_av.sources import SceneVideo, open_audio, open_video
from kontur_av.sources.source import BLOCK_SAMPLES
from pipelines.cores.capturing import Capturing
from pipelines.parts.robot_state import newest_state
from pipelines.runtime.process import PATIENCE_NS, Context
from pipelines.setup.table import VideoStream
from telepresence.world import audio_scenes, video_scenes


def run_camera(context: Context, *, name: str, stream: VideoStream) -> None:
    """Capture the pictures of the input `name` in the size and rate of `stream`.

    A built-in scene always counts its pictures, and draws them only while there is a reader.
    """
    clock = context.clock
    with context.open_bus() as bus:
        writer = bus.writer(
            context.topology.input(name).topic, max_octets=stream.width * stream.height * 3 // 2
        )
        source = open_video(
            context.setup.source(name),
            name=name,
            width=stream.width,
            height=stream.height,
            fps=stream.fps,
            clock=clock,
            scenes=video_scenes(newest_state(bus)),
        )
        capturing = Capturing(context.probe)
        context.on_flush(lambda: capturing.tell(source.faults, source.last_fault))
        # Drawing is most of a scene's work, and needless without a reader.
        scene = source if isinstance(source, SceneVideo) else None
        loan = writer.loan_picture(stream.width, stream.height)
        while not context.stopping:
            if scene is not None and not writer.has_readers():
                stamp = scene.skip(PATIENCE_NS, writer.has_readers)
            else:
                stamp = source.read(loan.picture, PATIENCE_NS)
                if stamp is not None:
                    loan.publish(stamp)
                    loan = writer.loan_picture(stream.width, stream.height)
            if stamp is not None:
                capturing.handle_captured(stamp)
            context.tick(clock.now_ns())
        loan.give_back()
        source.close()


def run_microphone(context: Context, *, name: str) -> None:
    """Capture the sound of the input `name`, 20 ms a sample of the topic."""
    clock = context.clock
    with context.open_bus() as bus:
        writer = bus.writer(context.topology.input(name).topic, max_octets=BLOCK_SAMPLES * 2)
        source = open_audio(
            context.setup.source(name),
            name=name,
            clock=clock,
            scenes=audio_scenes(newest_state(bus)),
        )
        capturing = Capturing(context.probe)
        context.on_flush(lambda: capturing.tell(source.faults, source.last_fault))
        while not context.stopping:
            frame = source.read(PATIENCE_NS)
            if frame is not None:
                writer.publish_audio(frame)
                capturing.handle_captured(frame.stamp)
            context.tick(clock.now_ns())
        source.close()
