"""SpaceJustin's upper body in MuJoCo, as a robot of a session; README.md says how to start it."""

from mujoco_robot.arm import LeftArm, SpaceJustin
from mujoco_robot.camera import HeadCamera

__all__ = ["HeadCamera", "LeftArm", "SpaceJustin"]
