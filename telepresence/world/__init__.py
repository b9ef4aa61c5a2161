"""The simulated task board: what the cameras see and the microphones hear.

`video_scenes` and `audio_scenes` return the factories behind `scene:NAME`. `DEFAULT_SCENES` maps
each input of a setup to the scene that it uses by default.
"""

from telepresence.world.scenes import CONTACT_SCENES as CONTACT_SCENES
from telepresence.world.scenes import DEFAULT_SCENES as DEFAULT_SCENES
from telepresence.world.scenes import VIEWS as VIEWS
from telepresence.world.scenes import audio_scenes as audio_scenes
from telepresence.world.scenes import render as render
from telepresence.world.scenes import video_scenes as video_scenes
from telepresence.world.state import BOARD_HEIGHT_M as BOARD_HEIGHT_M
from telepresence.world.state import BOARD_WIDTH_M as BOARD_WIDTH_M
from telepresence.world.state import LED_REACH_M as LED_REACH_M
from telepresence.world.state import LEDS_M as LEDS_M
from telepresence.world.state import WALL_X_M as WALL_X_M
from telepresence.world.state import StateAt as StateAt
from telepresence.world.state import WorldState as WorldState
from telepresence.world.state import scripted_state as scripted_state
