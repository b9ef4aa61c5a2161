"""Opens the sources that SPECs name, as in `--source NAME=SPEC`.

A SPEC is a path to a media file, or `mcap:FILE#CHANNEL`, `pipe:PATH`, `v4l2:DEVICE`, `alsa:DEVICE`,
`scene:NAME`, `rtsp://…` or another address, or `page` or `topic` for an input of a session that
only browser pages, or a joined program, fill. `module:Class`, or the name of an entry point of
`kontur_av.sources`, is a user's own. All of them are called as a scene's factory is, and with what
the SPEC names as last argument. A class's static method `check_source`, if it has one, refuses what
cannot work.
"""

import logging
import os
import re
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Literal

from kontur_av.clock import Clock, MonotonicClock
from kontur_av.errors import ConfigError
from kontur_av.media import AudioFrame, CaptureStamp, check_size
from kontur_av.parts import PluginRegistry, find_part, make_part, names_part
from kontur_av.sources.source import (
    FILLED_BY_OTHERS,
    PAGE,
    TOPIC,
    AudioSceneFactory,
    AudioSource,
    VideoSceneFactory,
    VideoSource,
)
from kontur_av.sources.user import UserSource

_SCENE, _FILE, _NETWORK = "scene", "file", "network"
#: The package's own clip of two seconds, where there is no such file.
CLIP = "clip.mp4"
_GROUP = "kontur_av.sources"
#: Addresses in a network; `rtp:` may be followed by an SDP file.
_ADDRESS = re.compile(r"(rtsp[su]?|https?|srt|udp|rtp)://|rtp:", re.IGNORECASE)
_FORMS = (
    "a media file, rtsp://HOST/PATH, mcap:FILE#CHANNEL, pipe:PATH, v4l2:DEVICE, alsa:DEVICE, "
    "scene:NAME, module:Class, page or topic"
)
_VIDEO = PluginRegistry(
    "source",
    _FORMS,
    _GROUP,
    {
        "mcap": "kontur_av.sources.recording:RecordedVideo",
        "pipe": "kontur_av.sources.pipe:PipeVideo",
        "v4l2": "kontur_av.sources.camera:CameraVideo",
        PAGE: "kontur_av.sources.source:PageVideo",
        TOPIC: "kontur_av.sources.source:PageVideo",
        _FILE: "kontur_av.sources.file:FileVideo",
        _NETWORK: "kontur_av.sources.network:NetworkVideo",
    },
)
_AUDIO = PluginRegistry(
    "source",
    _FORMS,
    _GROUP,
    {
        "mcap": "kontur_av.sources.recording:RecordedAudio",
        "alsa": "kontur_av.sources.microphone:MicrophoneAudio",
        PAGE: "kontur_av.sources.source:PageAudio",
        TOPIC: "kontur_av.sources.source:PageAudio",
        _FILE: "kontur_av.sources.file:FileAudio",
    },
)


def open_video(
    spec: str,
    *,
    name: str = "video",
    width: int = 640,
    height: int = 480,
    fps: float = 30,
    clock: Clock | None = None,
    scenes: Mapping[str, VideoSceneFactory] | None = None,
    wait: bool = True,
) -> VideoSource:
    """Open the pictures that `spec` names, in the given size.

    name: the input's name, used in every stamp.
    fps: rate of scenes and cameras; a file and a stream have their own.
    clock: by which pictures are stamped, in ns; by default CLOCK_MONOTONIC.
    scenes: factories for `scene:NAME`.
    wait: connect to an address before this returns; else it is tried until its peer answers.
    Raises ConfigError as `check_spec` does.
    """
    check_size(width, height)
    clock = clock or MonotonicClock()
    if (scene := _scene(spec, scenes or {})) is not None:
        return (scenes or {})[scene](name, width, height, fps, clock)
    spec = _with_kind(spec, _VIDEO)
    pictures: VideoSource = make_part(spec, _VIDEO, name, width, height, fps, clock, wait=wait)
    return UserSource(pictures, CaptureStamp, name, clock, spec) if _is_own(spec) else pictures


def open_audio(
    spec: str,
    *,
    name: str = "audio",
    clock: Clock | None = None,
    scenes: Mapping[str, AudioSceneFactory] | None = None,
) -> AudioSource:
    """Open the sound that `spec` names. Arguments and errors are those of `open_video`."""
    clock = clock or MonotonicClock()
    if (scene := _scene(spec, scenes or {})) is not None:
        return (scenes or {})[scene](name, clock)
    spec = _with_kind(spec, _AUDIO)
    sound: AudioSource = make_part(spec, _AUDIO, name, clock)
    return UserSource(sound, AudioFrame, name, clock, spec) if _is_own(spec) else sound


def _is_own(spec: str) -> bool:
    """Whether `spec`, with the name of its kind, names a user's own class."""
    return spec.partition(":")[0] not in {*_VIDEO.built_in, *_AUDIO.built_in}


def check_spec(spec: str, kind: Literal["video", "audio"], scenes: Iterable[str] = ()) -> None:
    """Refuse a SPEC that cannot work, before anything has started.

    scenes: the names that `scene:NAME` may use for this kind of input.
    Raises ConfigError with the fix. Causes: an unreadable file, one without pictures (or sound), a
    path that is not a FIFO, a device that cannot be opened, or an unknown scene.
    """
    if _scene(spec, scenes) is None:
        registry = _VIDEO if kind == "video" else _AUDIO
        made, text = find_part(_with_kind(spec, registry), registry)
        if (check := getattr(made, "check_source", None)) is not None:
            check(*text)


def _scene(spec: str, scenes: Iterable[str]) -> str | None:
    """Return the name in `scene:NAME`; None for another SPEC. ConfigError for an unknown one."""
    kind, colon, name = spec.partition(":")
    if not (colon and kind == _SCENE):
        return None
    _check_text(spec)
    known = sorted(scenes)
    if name not in known:
        raise ConfigError(f"no scene {name!r} for this input: choose one of {', '.join(known)}")
    return name


def _with_kind(spec: str, registry: PluginRegistry) -> str:
    """Return `spec`, of a path with the name of its kind. ConfigError for another kind of input."""
    kind, colon, _ = spec.partition(":")
    if not spec or "\0" in spec:
        raise ConfigError(f"source {spec!r} names nothing: give {registry.forms}")
    if kind in FILLED_BY_OTHERS:
        if colon:
            raise ConfigError(f"source {spec!r}: write {kind}")
        return spec
    if is_address(spec):
        kind, spec = _NETWORK, f"{_NETWORK}:{spec}"
    if colon and kind in {*_VIDEO.built_in, *_AUDIO.built_in} - {_FILE}:
        _check_text(spec)
        if kind not in registry.built_in:
            raise ConfigError(
                f"{spec!r} is sound, this input wants pictures: give a file, pipe: or v4l2:"
                if registry is _VIDEO
                else f"{spec.removeprefix(f'{_NETWORK}:')!r} is pictures, this input wants sound: "
                "give a file or alsa:DEVICE"
            )
        return spec
    # Unlike Path.exists, it raises nothing for a name that is too long.
    exists = os.path.exists(spec)  # noqa: PTH110
    if names_part(spec, registry) and not exists:
        return spec
    return f"{_FILE}:{spec if exists else _sample(spec)}"


def is_address(spec: str) -> bool:
    """Return whether a SPEC names a stream in a network."""
    return _ADDRESS.match(spec) is not None


def _check_text(spec: str) -> None:
    kind, _, text = spec.partition(":")
    if not text or "\0" in text:
        raise ConfigError(f"source {spec!r} names nothing: write {kind}: and what to open")


def played_file(spec: str) -> Path | None:
    """Return the file that a source plays; None for one that plays no file."""
    kind, _, text = spec.partition(":")
    path = text.rpartition("#")[0] or text if kind == "mcap" else _sample(spec)
    return Path(path) if path and os.path.exists(path) else None  # noqa: PTH110


def _sample(path: str) -> str:
    """Return the package's own clip for the name that the documents' examples have."""
    package = Path(__file__).resolve().parents[1]
    for folder in (package, package.parent / "samples"):
        if path == CLIP and (folder / CLIP).is_file():
            _say_own_clip()
            return str(folder / CLIP)
    return path


@cache
def _say_own_clip() -> None:
    """Once in a program: another file of this name may have been meant."""
    words = "there is no file %s here: the package's own clip is played"
    logging.getLogger(__name__).warning(words, CLIP)
