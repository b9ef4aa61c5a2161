"""Opens the sources that SPECs name, as in `--source NAME=SPEC`.

A SPEC is a path to a media file, or `mcap:FILE#CHANNEL`, `pipe:PATH`, `v4l2:DEVICE`, `alsa:DEVICE`,
`scene:NAME`, or `page` or `topic` for an input of a session that only browser pages, or a joined
program, fill. `module:Class`, or the name of an entry point of `GROUP`, is a user's own: called as
a scene's factory is.
"""

import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Literal

from kontur_av.clock import Clock
from kontur_av.errors import ConfigError
from kontur_av.media import check_size
from kontur_av.parts import find_part, make_part, names_part
from kontur_av.sources.page import FILLED_BY_OTHERS, PageAudio, PageVideo
from kontur_av.sources.source import AudioSceneFactory, AudioSource, VideoSceneFactory, VideoSource

# Kinds are imported on demand, so that a process that draws a scene does not load FFmpeg.

_KINDS = ("mcap", "pipe", "v4l2", "alsa", "scene")
#: The package's own clip of two seconds, where there is no such file.
CLIP = "clip.mp4"
#: A user's class, and the entry points of such classes.
_PART, GROUP = "part", "kontur_av.sources"


def open_video(
    spec: str,
    *,
    name: str,
    width: int,
    height: int,
    fps: int,
    clock: Clock,
    scenes: Mapping[str, VideoSceneFactory] | None = None,
) -> VideoSource:
    """Open the pictures that `spec` names, in the given size.

    name: the input's name, used in every stamp.
    fps: rate of scenes and cameras; a file has its own.
    scenes: factories for `scene:NAME`.
    Raises ConfigError as `check_spec` does.
    """
    check_size(width, height)
    kind, rest = _split(spec)
    if kind == "scene":
        known = scenes or {}
        _check_scene(rest, known)
        return known[rest](name, width, height, fps, clock)
    if kind == "pipe":
        from kontur_av.sources.pipe import PipeVideo

        return PipeVideo(rest, name=name, width=width, height=height, fps=fps, clock=clock)
    if kind == "v4l2":
        from kontur_av.sources.camera import CameraVideo

        return CameraVideo(rest, name=name, width=width, height=height, fps=fps, clock=clock)
    if kind in FILLED_BY_OTHERS:
        return PageVideo(clock)
    if kind == "mcap":
        from kontur_av.sources.recording import RecordedVideo

        return RecordedVideo(rest, name=name, width=width, height=height, fps=fps, clock=clock)
    if kind == "alsa":
        raise _no_pictures(spec)
    if kind == _PART:
        pictures: VideoSource = make_part(spec, GROUP, name, width, height, fps, clock)
        return pictures
    from kontur_av.sources.file import FileVideo

    return FileVideo(rest, name=name, width=width, height=height, fps=fps, clock=clock)


def open_audio(
    spec: str, *, name: str, clock: Clock, scenes: Mapping[str, AudioSceneFactory] | None = None
) -> AudioSource:
    """Open the sound that `spec` names. Arguments and errors are those of `open_video`."""
    kind, rest = _split(spec)
    if kind == "scene":
        known = scenes or {}
        _check_scene(rest, known)
        return known[rest](name, clock)
    if kind == "alsa":
        from kontur_av.sources.microphone import MicrophoneAudio

        return MicrophoneAudio(rest, name=name, clock=clock)
    if kind in FILLED_BY_OTHERS:
        return PageAudio(clock)
    if kind == "mcap":
        from kontur_av.sources.recording import RecordedAudio

        return RecordedAudio(rest, name=name, clock=clock)
    if kind in ("pipe", "v4l2"):
        raise _no_sound(spec)
    if kind == _PART:
        sound: AudioSource = make_part(spec, GROUP, name, clock)
        return sound
    from kontur_av.sources.file import FileAudio

    return FileAudio(rest, name=name, clock=clock)


def check_spec(spec: str, kind: Literal["video", "audio"], scenes: Iterable[str] = ()) -> None:
    """Refuse a SPEC that cannot work, before anything has started.

    scenes: the names that `scene:NAME` may use for this kind of input.
    Raises ConfigError with the mend. Causes: an unreadable file, one without pictures (or sound), a
    path that is not a FIFO, a device that cannot be opened, or an unknown scene.
    """
    family, rest = _split(spec)
    if family in FILLED_BY_OTHERS:
        return
    if family == "scene":
        _check_scene(rest, scenes)
    elif kind == "video" and family == "alsa":
        raise _no_pictures(spec)
    elif kind == "audio" and family in ("pipe", "v4l2"):
        raise _no_sound(spec)
    elif family == "mcap":
        from kontur_av.sources.recording import check_recording

        check_recording(rest, kind)
    elif family == "pipe":
        from kontur_av.sources.pipe import check_fifo

        check_fifo(rest)
    elif family == "v4l2":
        from kontur_av.sources.camera import check_camera

        check_camera(rest)
    elif family == "alsa":
        from kontur_av.sources.microphone import check_microphone

        check_microphone(rest)
    elif family == _PART:
        find_part(spec, GROUP)
    else:
        from kontur_av.sources.file import check_file

        check_file(rest, kind)


def _split(spec: str) -> tuple[str, str]:
    kind, colon, rest = spec.partition(":")
    if "\0" in spec:
        rest = ""
    if colon and kind in _KINDS:
        if not rest:
            raise ConfigError(f"source {spec!r} names nothing: write {kind}: and what to open")
        return kind, rest
    if spec in FILLED_BY_OTHERS:
        return spec, ""
    if not spec or "\0" in spec:
        raise ConfigError(
            f"source {spec!r} names nothing: give a media file, mcap:FILE#CHANNEL, pipe:PATH, "
            "v4l2:DEVICE, alsa:DEVICE, scene:NAME, module:Class, page or topic"
        )
    # Unlike Path.exists, it raises nothing for a name that is too long.
    exists = os.path.exists(spec)  # noqa: PTH110
    if names_part(spec, GROUP) and not exists:
        return _PART, spec
    return "file", spec if exists else _sample(spec)


def _sample(path: str) -> str:
    """Return the package's own clip for the name that the documents' examples have."""
    package = Path(__file__).resolve().parents[1]
    for folder in (package, package.parent / "samples"):
        if path == CLIP and (folder / CLIP).is_file():
            return str(folder / CLIP)
    return path


def _check_scene(name: str, scenes: Iterable[str]) -> None:
    known = sorted(scenes)
    if name not in known:
        raise ConfigError(f"no scene {name!r} for this input: choose one of {', '.join(known)}")


def _no_pictures(spec: str) -> ConfigError:
    return ConfigError(f"{spec!r} is sound, this input wants pictures: give a file, pipe: or v4l2:")


def _no_sound(spec: str) -> ConfigError:
    return ConfigError(f"{spec!r} is pictures, this input wants sound: give a file or alsa:DEVICE")
