"""The arm of an unknown sender's model in a session: Fetch, of the package gymnasium-robotics.

    pip install gymnasium-robotics
    kontur-av stream --setup taskboard --robot strangers_arm:Fetch

in this file's directory. The model takes places: its hand follows a body that is put there. The
session's plane is upright, before the robot: x to its right, y up. It touches nothing.
"""

from importlib.util import find_spec
from pathlib import Path

import numpy as np

from kontur_av import ConfigError
from telepresence import RobotCapabilities, RobotReading

PLANE = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0]])
MIDDLE = np.array([1.28, 0.75, 0.6])


class Fetch:
    """A `RobotDevice` that takes places."""

    capabilities = RobotCapabilities(
        name="Fetch", takes="position", speed_m_s=0.25, half_width_m=0.17, half_height_m=0.12
    )

    def configure(self) -> None:
        found = find_spec("gymnasium_robotics")
        if found is None or not found.submodule_search_locations:
            raise ConfigError("Fetch needs its model: pip install gymnasium-robotics")
        import mujoco

        package = Path(found.submodule_search_locations[0])
        self.model = mujoco.MjModel.from_xml_path(str(package / "envs/assets/fetch/reach.xml"))
        self.model.opt.timestep = 0.001
        # What leads the hand is harder than its force can be felt, so there are no contacts.
        self.model.geom_contype[:] = self.model.geom_conaffinity[:] = 0
        # The hand is to be where the body is that leads it, and not beside it.
        self.model.eq_data[0, 3:10] = 0, 0, 0, 1, 0, 0, 0
        # Damped, so that it rests soon after it was switched off.
        self.model.eq_solref[0] = 0.02, 2.0
        self.data, self.step = mujoco.MjData(self.model), mujoco.mj_step
        for joint, place in (("slide0", 0.405), ("slide1", 0.48), ("slide2", 0.0)):
            self.data.joint(f"robot0:{joint}").qpos = place
        self.hand = self.model.body("robot0:gripper_link").id
        self.active, self.wanted = False, np.zeros(2)
        for _ in range(2000):
            self.advance(1_000_000)

    def power_on(self) -> None: ...

    def activate(self) -> None:
        self.active = True

    def deactivate(self) -> None:
        self.active, self.wanted = False, self.place()

    def power_off(self) -> None:
        self.deactivate()

    def place(self) -> np.ndarray:
        return PLANE @ (self.data.xpos[self.hand] - MIDDLE)

    def read(self) -> RobotReading:
        speed = PLANE @ self.data.cvel[self.hand, 3:]
        return RobotReading(*self.place().tolist(), *speed.tolist())

    def write_force(self, x_n: float, y_n: float) -> None:
        raise NotImplementedError("it takes places")

    def write_position(self, x_m: float, y_m: float, vx_m_s: float, vy_m_s: float) -> None:
        if self.active:
            self.wanted = np.array([x_m, y_m])

    def advance(self, dt_ns: int) -> None:
        self.data.mocap_pos[0] = MIDDLE + PLANE.T @ self.wanted
        self.step(self.model, self.data)
