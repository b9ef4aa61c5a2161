"""The processes in space: joystick, console, gateway, and what the operator sees and hears."""

from functools import partial

from pipelines.parts.capture import run_camera, run_microphone
from pipelines.parts.console import run_console
from pipelines.parts.display import run_display
from pipelines.parts.gateway import run_gateway
from pipelines.parts.haptic_ends import run_joystick
from pipelines.parts.video_receive import run_video_receive
from pipelines.parts.video_send import run_video_send
from pipelines.parts.voice_receive import run_voice_receive
from pipelines.parts.voice_send import run_voice_send
from pipelines.runtime.process import Part
from pipelines.setup.names import input_topic
from pipelines.setup.table import Setup
from pipelines.topology import LOOP_PRIORITY, VOICE_PRIORITY, Segment, Stage
from telepresence.haptics.device.spec import SIMULATED


def space_parts(setup: Setup, *, joystick: str = SIMULATED) -> list[Part]:
    """What runs in space for `setup`, with the joystick of this SPEC."""
    up, voice_up = setup.uplink_video, setup.uplink_voice
    down, voice_down = setup.downlink_video, setup.downlink_voice
    parts = [
        Part(
            "space_gateway", Stage.LINK, partial(run_gateway, segment=Segment.SPACE), LOOP_PRIORITY
        ),
        Part("joystick", Stage.LINK, partial(run_joystick, spec=joystick), LOOP_PRIORITY),
        Part("console", Stage.LINK, run_console),
        Part("uplink_video_receive", Stage.RECEIVER, partial(run_video_receive, stream=up)),
    ]
    if voice_up:
        hear = partial(run_voice_receive, stream=voice_up)
        parts.append(Part("uplink_voice_receive", Stage.RECEIVER, hear, VOICE_PRIORITY))
    received = [stream for stream in (up, voice_up) if stream is not None]
    parts.append(
        Part(
            "space_display",
            Stage.SINK,
            partial(run_display, streams=received),
            VOICE_PRIORITY,
        )
    )
    if down:
        name = "iss_camera"
        send = partial(run_video_send, stream=down, topic=input_topic(name))
        parts.append(Part(name, Stage.SOURCE, partial(run_camera, name=name, stream=down)))
        parts.append(Part("downlink_video_send", Stage.SENDER, send))
    if voice_down:
        name = "iss_mic"
        say = partial(run_voice_send, stream=voice_down, topic=input_topic(name))
        parts.append(Part(name, Stage.SOURCE, partial(run_microphone, name=name), VOICE_PRIORITY))
        parts.append(Part("downlink_voice_send", Stage.SENDER, say, VOICE_PRIORITY))
    return parts
