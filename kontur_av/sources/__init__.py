"""Sources of pictures and sound: files, live pipes, cameras, microphones, scenes."""

from typing import TYPE_CHECKING

from kontur_av.lazy import lazy_names

if TYPE_CHECKING:
    from kontur_av.sources.scene import SceneAudio, SceneVideo
    from kontur_av.sources.source import AudioSource, VideoSource
    from kontur_av.sources.spec import check_spec, open_audio, open_video
    from kontur_av.sources.stereo import SeamFinder, merge

__all__ = [
    "AudioSource",
    "SceneAudio",
    "SceneVideo",
    "SeamFinder",
    "VideoSource",
    "check_spec",
    "merge",
    "open_audio",
    "open_video",
]

__getattr__, __dir__ = lazy_names(__name__)
