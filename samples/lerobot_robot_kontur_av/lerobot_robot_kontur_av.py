"""The robot of a running session as a robot of LeRobot: its policies drive it at the handle.

    kontur-av stream --setup taskboard --joystick page &
    pip install ./samples/lerobot_robot_kontur_av
    lerobot-record --robot.type=kontur_av --policy.path=... --dataset...

Then hand over at the page. A person takes the handle back at any time; what the policy still says
is recorded and not obeyed. LeRobot itself was not run: a test holds this class to its interface.
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from lerobot.robots import Robot, RobotConfig

from pipelines import Driving, JoinedSession


@RobotConfig.register_subclass("kontur_av")
@dataclass
class KonturAvConfig(RobotConfig):
    """session: None: the only one that runs. axes, width, height: as of its setup.

    hz: how often LeRobot acts. shadow: its actions are recorded, and never obeyed.
    """

    session: str | None = None
    axes: list[str] = field(default_factory=lambda: ["x", "y"])
    width: int = 640
    height: int = 480
    hz: float = 30.0
    shadow: bool = False


class KonturAv(Robot):
    config_class = KonturAvConfig
    name = "kontur_av"

    def __init__(self, config: KonturAvConfig) -> None:
        super().__init__(config)
        self.config = config
        self._joined: JoinedSession | None = None
        self._driving: Driving | None = None

    @cached_property
    def observation_features(self) -> dict[str, Any]:
        return self.action_features | {"picture": (self.config.height, self.config.width, 3)}

    @cached_property
    def action_features(self) -> dict[str, Any]:
        """By axis: where the robot is to be, m or rad."""
        return {f"{axis}.pos": float for axis in self.config.axes}

    @property
    def is_connected(self) -> bool:
        return self._driving is not None

    @property
    def is_calibrated(self) -> bool:
        return True

    def connect(self, calibrate: bool = True) -> None:
        self._joined = JoinedSession(self.config.session)
        shadow, hz = self.config.shadow, self.config.hz
        self._driving = Driving(self._joined, "lerobot", hz=hz, shadow=shadow)

    def calibrate(self) -> None: ...

    def configure(self) -> None: ...

    def get_observation(self) -> dict[str, Any]:
        assert self._driving is not None, "connect first"
        seen = self._driving.observe()
        dark = np.zeros(self.observation_features["picture"], np.uint8)
        picture = dark if seen.picture is None else seen.picture.data
        return {f"{axis}.pos": seen.robot[axis] for axis in self.config.axes} | {"picture": picture}

    def send_action(self, action: dict[str, Any]) -> dict[str, Any]:
        assert self._driving is not None, "connect first"
        self._driving.act({axis: action[f"{axis}.pos"] for axis in self.config.axes})
        return action

    def disconnect(self) -> None:
        if self._driving is not None and self._joined is not None:
            self._driving.close()
            self._joined.close()
        self._driving = None
