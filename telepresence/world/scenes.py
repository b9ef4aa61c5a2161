"""The scenes behind `scene:NAME`, and the factories of their sources. A shell: it reads speech."""

from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kontur_av.clock import Clock
from kontur_av.errors import ConfigError
from kontur_av.media import AUDIO_CLOCK_HZ, I420, check_size
from kontur_av.sources.scene import SceneAudio, SceneVideo
from kontur_av.sources.source import AudioSceneFactory, AudioSource, VideoSceneFactory, VideoSource
from telepresence.world.cabin import CabinView
from telepresence.world.ground_views import GroundView
from telepresence.world.sound import Room, Speaker, Speech
from telepresence.world.state import StateAt, WorldState, scripted_state


def media_folder() -> Path:
    """Return the folder of the sample media: in the installed package, or in the checkout."""
    package = Path(__file__).resolve().parents[1]
    for folder in (package / "media", package.parent / "samples" / "media"):
        if (folder / "speech_ground.flac").is_file():
            return folder
    raise ConfigError("the speech samples are missing: run `python samples/make_speech.py`")


@lru_cache(maxsize=2)
def read_speech(speaker: Speaker) -> Speech:
    """Return a speaker's sample, which all callers share. ConfigError if its file is missing."""
    # Imported on demand, because only processes with speech need FFmpeg.
    import av

    resampler = av.AudioResampler("s16", "mono", AUDIO_CLOCK_HZ)
    pieces: list[NDArray[np.generic]] = []
    with av.open(str(media_folder() / f"speech_{speaker}.flac")) as container:
        for frame in container.decode(audio=0):
            pieces += (piece.to_ndarray().reshape(-1) for piece in resampler.resample(frame))
    pieces += (piece.to_ndarray().reshape(-1) for piece in resampler.resample(None))
    return Speech(np.concatenate(pieces).astype(np.int16, copy=False))


#: Each camera, and its capture phase within a period. The stereo pair captures together; the
#: others are staggered, so that they do not need the processor at the same instant.
VIEWS: dict[str, float] = {"left": 0.0, "right": 0.0, "static": 0.34, "head": 0.67, "cabin": 0.5}

#: The scene of each input of a setup, unless the user names another source.
DEFAULT_SCENES: dict[str, str] = {
    "left": "scene:left",
    "right": "scene:right",
    "static": "scene:static",
    "head": "scene:head",
    "operator_camera": "scene:cabin",
    "ground_mic": "scene:ground_voice",
    "operator_mic": "scene:cabin_voice",
}

#: The scenes in which a contact of the stylus with a target can be seen or heard.
CONTACT_SCENES = frozenset(
    {"scene:left", "scene:right", "scene:static", "scene:head", "scene:ground_voice"}
)


@lru_cache(maxsize=16)
def _view(view: str, width: int, height: int) -> GroundView | CabinView:
    if view not in VIEWS:
        raise ConfigError(f"no scene {view!r}: choose one of {', '.join(sorted(VIEWS))}")
    check_size(width, height)
    if view == "cabin":
        return CabinView(width, height, read_speech("cabin"))
    return GroundView(view, width, height)


def render(view: str, state: WorldState, into: I420, frame: int = 0) -> None:
    """Write what the camera `view` sees of `state` into `into`.

    into: shape (height * 3 // 2, width), uint8, C-contiguous. frame: the number in the corner.
    Equal arguments give equal pictures. The first call for a view and a size draws its background
    (half a second). Raises ConfigError for an unknown view.
    """
    _view(view, into.shape[1], into.shape[0] * 2 // 3).draw(state, into, frame)


def video_scenes(state_at: StateAt = scripted_state) -> dict[str, VideoSceneFactory]:
    """Return the factories for `open_video(..., scenes=...)`.

    state_at: now_ns -> WorldState, called once a picture; it returns the robot's newest state.
    """

    def factory(view: str, phase: float) -> VideoSceneFactory:
        def make(name: str, width: int, height: int, fps: float, clock: Clock) -> VideoSource:
            drawn = _view(view, width, height)

            def draw(into: I420, sequence: int, capture_ns: int) -> None:
                drawn.draw(state_at(capture_ns), into, sequence)

            return SceneVideo(draw, name=name, fps=fps, clock=clock, phase=phase)

        return make

    return {view: factory(view, phase) for view, phase in VIEWS.items()}


def audio_scenes(state_at: StateAt = scripted_state) -> dict[str, AudioSceneFactory]:
    """Return the factories for `open_audio(..., scenes=...)`; `state_at` triggers the clicks."""

    def factory(make_room: Callable[[], Room]) -> AudioSceneFactory:
        def make(name: str, clock: Clock) -> AudioSource:
            return SceneAudio(make_room().fill, name=name, clock=clock)

        return make

    return {
        "ground_voice": factory(
            lambda: Room(read_speech("ground"), fan=False, state_at=state_at, seed=21)
        ),
        "cabin_voice": factory(
            lambda: Room(read_speech("cabin"), fan=True, state_at=None, seed=22)
        ),
    }
