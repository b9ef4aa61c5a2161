"""Sources of pictures and sound: files, live pipes, cameras, microphones, scenes."""

from kontur_av.sources.scene import SceneAudio, SceneVideo
from kontur_av.sources.source import (
    BLOCK_NS,
    BLOCK_SAMPLES,
    AudioSceneFactory,
    AudioSource,
    VideoSceneFactory,
    VideoSource,
)
from kontur_av.sources.spec import check_spec, open_audio, open_video

__all__ = [
    "BLOCK_NS",
    "BLOCK_SAMPLES",
    "AudioSceneFactory",
    "AudioSource",
    "SceneAudio",
    "SceneVideo",
    "VideoSceneFactory",
    "VideoSource",
    "check_spec",
    "open_audio",
    "open_video",
]
