"""What `kontur-av send` and the commands that speak WebRTC send, as their options say."""

import argparse

from kontur_av.clock import MonotonicClock
from kontur_av.errors import ConfigError
from kontur_av.media import parse_size
from kontur_av.sources import AudioSource, VideoSource, open_audio, open_video
from kontur_av.sources.source import FILLED_BY_OTHERS


def open_pictures(args: argparse.Namespace, clock: MonotonicClock) -> VideoSource:
    """The source of `--video`, of `--size` and `--fps`. ConfigError."""
    check_alone(args.video)
    scenes = None
    if args.video.startswith("scene:"):
        from telepresence.world import video_scenes

        scenes = video_scenes()
    width, height = parse_size(args.size)
    return open_video(
        args.video,
        name="video",
        width=width,
        height=height,
        fps=args.fps,
        clock=clock,
        scenes=scenes,
    )


def open_sound(args: argparse.Namespace, clock: MonotonicClock) -> AudioSource:
    """The source of `--audio`. ConfigError."""
    check_alone(args.audio)
    scenes = None
    if args.audio.startswith("scene:"):
        from telepresence.world import audio_scenes

        scenes = audio_scenes()
    return open_audio(args.audio, name="audio", clock=clock, scenes=scenes)


def check_alone(spec: str | None) -> None:
    """ConfigError for a source that only a session has."""
    if spec in FILLED_BY_OTHERS:
        raise ConfigError(
            f"only a session has the source {spec}: give another one, "
            f"or `kontur-av stream --source NAME={spec}`"
        )
