"""What `kontur-av send` and the commands that speak WebRTC send, as their options say."""

import argparse
from collections.abc import Mapping
from typing import Any

from kontur_av.clock import MonotonicClock
from kontur_av.errors import ConfigError
from kontur_av.media import parse_size
from kontur_av.sources import AudioSource, VideoSource, open_audio, open_video
from kontur_av.sources.source import FILLED_BY_OTHERS


def open_pictures(args: argparse.Namespace, clock: MonotonicClock) -> VideoSource:
    """The source of `--video`, of `--size` and `--fps`. ConfigError."""
    width, height = parse_size(args.size)
    return open_video(
        args.video,
        width=width,
        height=height,
        fps=args.fps,
        clock=clock,
        scenes=scenes_of(args.video),
    )


def open_sound(args: argparse.Namespace, clock: MonotonicClock) -> AudioSource:
    """The source of `--audio`. ConfigError."""
    return open_audio(args.audio, clock=clock, scenes=scenes_of(args.audio, sound=True))


def scenes_of(spec: str, *, sound: bool = False) -> Mapping[str, Any] | None:
    """The scenes of the world for a SPEC that names one. ConfigError as of `check_alone`."""
    check_alone(spec)
    if not spec.startswith("scene:"):
        return None
    from telepresence.world import audio_scenes, video_scenes

    return audio_scenes() if sound else video_scenes()


def check_alone(spec: str | None) -> None:
    """ConfigError for a source that only a session has."""
    if spec in FILLED_BY_OTHERS:
        raise ConfigError(
            f"only a session has the source {spec}: give another one, "
            f"or `kontur-av stream --source NAME={spec}`"
        )
