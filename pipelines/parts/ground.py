"""The processes on the ground: cameras, robot, gateway, and what the people there see and hear."""

from functools import partial

from pipelines.parts.capture import run_camera, run_microphone
from pipelines.parts.display import run_display
from pipelines.parts.gateway import run_gateway
from pipelines.parts.haptic_ends import run_robot
from pipelines.parts.selector import run_selector
from pipelines.parts.stereo import run_stereo
from pipelines.parts.video_receive import run_video_receive
from pipelines.parts.video_send import run_video_send
from pipelines.parts.voice_receive import run_voice_receive
from pipelines.parts.voice_send import run_voice_send
from pipelines.runtime.process import Part
from pipelines.setup.names import SELECTED_TOPIC, input_topic
from pipelines.setup.table import STEREO, Setup
from pipelines.topology import LOOP_PRIORITY, VOICE_PRIORITY, Segment, Stage


def ground_parts(setup: Setup) -> list[Part]:
    """What runs on the ground for `setup`."""
    up, voice_up = setup.uplink_video, setup.uplink_voice
    down, voice_down = setup.downlink_video, setup.downlink_voice
    parts = [
        Part(
            "ground_gateway",
            Stage.LINK,
            partial(run_gateway, segment=Segment.GROUND),
            LOOP_PRIORITY,
        ),
        Part("robot", Stage.LINK, run_robot, LOOP_PRIORITY),
    ]
    parts += [
        Part(f"camera_{name}", Stage.SOURCE, partial(run_camera, name=name, stream=up))
        for name in setup.camera_inputs
    ]
    if STEREO in setup.cameras:
        parts.append(Part("stereo", Stage.RELAY, run_stereo))
    parts.append(Part("selector", Stage.RELAY, run_selector))
    send = partial(run_video_send, stream=up, topic=SELECTED_TOPIC)
    parts.append(Part("uplink_video_send", Stage.SENDER, send))
    if voice_up:
        name = "ground_mic"
        say = partial(run_voice_send, stream=voice_up, topic=input_topic(name))
        parts.append(Part(name, Stage.SOURCE, partial(run_microphone, name=name), VOICE_PRIORITY))
        parts.append(Part("uplink_voice_send", Stage.SENDER, say, VOICE_PRIORITY))
    if down:
        see = partial(run_video_receive, stream=down)
        parts.append(Part("downlink_video_receive", Stage.RECEIVER, see))
    if voice_down:
        hear = partial(run_voice_receive, stream=voice_down)
        parts.append(Part("downlink_voice_receive", Stage.RECEIVER, hear, VOICE_PRIORITY))
    received = [stream for stream in (down, voice_down) if stream is not None]
    if received:
        parts.append(
            Part(
                "ground_display",
                Stage.SINK,
                partial(run_display, streams=received),
                VOICE_PRIORITY,
            )
        )
    return parts
