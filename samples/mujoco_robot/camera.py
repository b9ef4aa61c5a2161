"""What a camera of the model sees, as a source of pictures."""

import os
from typing import Any

import cv2

from kontur_av.clock import Clock
from kontur_av.media import I420
from kontur_av.sources import SceneVideo
from mujoco_robot.messages import ORDER, PHYSICS, SHOW, own_socket, session_directory

#: The physics answers within a step of 1 ms.
_TIMEOUT_S = 0.01


class HeadCamera(SceneVideo):
    """A `VideoSource`: the picture of the head's camera, or of another one in the model.

    It renders what the physics of the session shows; without one, the last that was known.
    """

    def __init__(
        self, name: str, width: int, height: int, fps: int, clock: Clock, camera: str = "head"
    ) -> None:
        super().__init__(self._render, name=name, fps=fps, clock=clock)
        # Software that needs no screen; with a graphics card `MUJOCO_GL=egl` is quicker.
        os.environ.setdefault("MUJOCO_GL", "osmesa")
        import mujoco

        from mujoco_robot.physics import World

        world = World()
        self._mujoco, self._model, self._data = mujoco, world.model, world.data
        self._renderer: Any = mujoco.Renderer(self._model, height, width)
        self._camera, self._places_octets = camera, self._data.qpos.nbytes
        self._physics = session_directory() / PHYSICS
        self._path = session_directory() / f"camera-{name}"
        self._udp = own_socket(self._path)
        self._udp.settimeout(_TIMEOUT_S)

    def close(self) -> None:
        """Release the socket and the renderer."""
        self._udp.close()
        self._path.unlink(missing_ok=True)
        self._renderer.close()

    def _render(self, into: I420, _sequence: int, _capture_ns: int) -> None:
        mujoco, data = self._mujoco, self._data
        try:
            self._udp.sendto(ORDER.pack(SHOW, 0, 0.0, 0.0), str(self._physics))
            data.qpos[:] = memoryview(self._udp.recv(self._places_octets)).cast("d")
        except OSError:
            # It starts, or is started again.
            self.faults += 1
            self.last_fault = "the physics does not answer"
        mujoco.mj_kinematics(self._model, data)
        mujoco.mj_camlight(self._model, data)
        self._renderer.update_scene(data, camera=self._camera)
        cv2.cvtColor(self._renderer.render(), cv2.COLOR_RGB2YUV_I420, dst=into)
