"""The names behind `scene:NAME`, and how a process gets a source for one of them."""

from collections.abc import Callable
from functools import lru_cache

from kontur_av.clock import Clock
from kontur_av.errors import ConfigError
from kontur_av.media import I420, check_size
from kontur_av.sources.scene import SceneAudio, SceneVideo
from kontur_av.sources.source import (
    AudioSceneFactory,
    AudioSource,
    VideoSceneFactory,
    VideoSource,
)
from telepresence.world.cabin import CabinView
from telepresence.world.ground_views import GroundView
from telepresence.world.sound import Room
from telepresence.world.state import StateAt, WorldState, scripted_state

#: Each camera, and where in a period it captures. The stereo pair captures together; the
#: others don't all want the processor at the same instant.
VIEWS: dict[str, float] = {
    "left": 0.0,
    "right": 0.0,
    "static": 0.34,
    "head": 0.67,
    "cabin": 0.5,
}

#: What each input of a setup shows or hears when the user names nothing else.
DEFAULT_SCENES: dict[str, str] = {
    "left": "scene:left",
    "right": "scene:right",
    "static": "scene:static",
    "head": "scene:head",
    "iss_camera": "scene:cabin",
    "ground_mic": "scene:ground_voice",
    "iss_mic": "scene:cabin_voice",
}

#: Where the stylus's contact with a target is to be seen or heard.
CONTACT_SCENES = frozenset(
    {"scene:left", "scene:right", "scene:static", "scene:head", "scene:ground_voice"}
)


@lru_cache(maxsize=16)
def _view(view: str, width: int, height: int) -> GroundView | CabinView:
    if view not in VIEWS:
        raise ConfigError(f"no scene {view!r}: choose one of {', '.join(sorted(VIEWS))}")
    check_size(width, height)
    return CabinView(width, height) if view == "cabin" else GroundView(view, width, height)


def render(view: str, state: WorldState, into: I420, frame: int = 0) -> None:
    """Write what the camera `view` sees of `state` into `into`, whole.

    into: shape (height * 3 // 2, width), uint8, C-contiguous. frame: the number burned into
    the corner. The same arguments give the same picture. The first call for a view and size
    draws its background (half a second). Raises ConfigError for an unknown view.
    """
    _view(view, into.shape[1], into.shape[0] * 2 // 3).draw(state, into, frame)


def video_scenes(state_at: StateAt = scripted_state) -> dict[str, VideoSceneFactory]:
    """The factories for `open_video(..., scenes=...)`.

    state_at: now_ns -> WorldState, asked once a picture; the robot's newest state goes in here.
    """

    def factory(view: str, phase: float) -> VideoSceneFactory:
        def make(name: str, width: int, height: int, fps: int, clock: Clock) -> VideoSource:
            drawn = _view(view, width, height)

            def draw(into: I420, sequence: int, capture_ns: int) -> None:
                drawn.draw(state_at(capture_ns), into, sequence)

            return SceneVideo(draw, name=name, fps=fps, clock=clock, phase=phase)

        return make

    return {view: factory(view, phase) for view, phase in VIEWS.items()}


def audio_scenes(state_at: StateAt = scripted_state) -> dict[str, AudioSceneFactory]:
    """The factories for `open_audio(..., scenes=...)`; `state_at` makes the click on the ground."""

    def factory(make_room: Callable[[], Room]) -> AudioSceneFactory:
        def make(name: str, clock: Clock) -> AudioSource:
            return SceneAudio(make_room().fill, name=name, clock=clock)

        return make

    return {
        "ground_voice": factory(lambda: Room("ground", fan=False, state_at=state_at, seed=21)),
        "cabin_voice": factory(lambda: Room("cabin", fan=True, state_at=None, seed=22)),
    }
