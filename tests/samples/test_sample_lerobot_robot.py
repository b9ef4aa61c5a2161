"""samples/lerobot_robot_kontur_av against LeRobot's interface, as of 0.4: it is not installed."""

import inspect
import sys
from types import ModuleType, SimpleNamespace

from positions import ROOT

#: `lerobot.robots.Robot`: properties, then its abstract methods with their parameters.
PROPERTIES = ("observation_features", "action_features", "is_connected", "is_calibrated")
METHODS = {
    "connect": ["self", "calibrate"],
    **{name: ["self"] for name in ("calibrate", "configure", "get_observation", "disconnect")},
    "send_action": ["self", "action"],
}


class Robot:
    def __init__(self, config):
        self.robot_type = self.name


class RobotConfig:
    @classmethod
    def register_subclass(cls, name):
        return lambda subclass: subclass


def test_the_plug_in_has_the_interface_and_passes_places_by_axis(monkeypatch):
    module = ModuleType("lerobot.robots")
    module.Robot, module.RobotConfig = Robot, RobotConfig
    monkeypatch.setitem(sys.modules, "lerobot", ModuleType("lerobot"))
    monkeypatch.setitem(sys.modules, "lerobot.robots", module)
    monkeypatch.syspath_prepend(ROOT / "samples" / "lerobot_robot_kontur_av")
    from lerobot_robot_kontur_av import KonturAv, KonturAvConfig

    for name, parameters in METHODS.items():
        assert list(inspect.signature(getattr(KonturAv, name)).parameters) == parameters
    robot = KonturAv(KonturAvConfig(axes=["x", "yaw"]))
    assert all(hasattr(robot, name) for name in PROPERTIES) and not robot.is_connected
    acts = []
    seen = SimpleNamespace(robot={"x": 0.1, "yaw": 0.2}, picture=None)
    robot._driving = SimpleNamespace(observe=lambda: seen, act=acts.append)
    observation = robot.get_observation()
    assert observation.keys() == robot.observation_features.keys()
    assert observation["yaw.pos"] == 0.2 and observation["picture"].shape == (480, 640, 3)
    robot.send_action({"x.pos": 0.3, "yaw.pos": 0.4})
    assert acts == [{"x": 0.3, "yaw": 0.4}]
