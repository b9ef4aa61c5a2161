"""The simulated task board: what the cameras see and the microphones hear.

`video_scenes` and `audio_scenes` return the factories behind `scene:NAME`. `DEFAULT_SCENES` maps
each input of a setup to the scene that it uses by default.
"""

from telepresence.world.scenes import (
    CONTACT_SCENES,
    DEFAULT_SCENES,
    VIEWS,
    audio_scenes,
    render,
    video_scenes,
)
from telepresence.world.state import (
    BOARD_HEIGHT_M,
    BOARD_WIDTH_M,
    LED_REACH_M,
    LEDS_M,
    WALL_X_M,
    StateAt,
    WorldState,
    scripted_state,
)

__all__ = [
    "BOARD_HEIGHT_M",
    "BOARD_WIDTH_M",
    "CONTACT_SCENES",
    "DEFAULT_SCENES",
    "LEDS_M",
    "LED_REACH_M",
    "VIEWS",
    "WALL_X_M",
    "StateAt",
    "WorldState",
    "audio_scenes",
    "render",
    "scripted_state",
    "video_scenes",
]
