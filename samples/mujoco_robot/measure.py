"""Measures the CPU time of a step: `python -m mujoco_robot.measure`."""

import time

import mujoco

from kontur_av.clock import NS_PER_MS
from mujoco_robot.messages import FOLLOW
from mujoco_robot.physics import World

_STEPS = 5000


def _measured_us(begin_ns: int) -> float:
    return (time.process_time_ns() - begin_ns) / _STEPS / 1000


def main() -> None:
    """Print the time of `mj_step`, and of a whole step with the control of both arms."""
    world, now_ns = World(), 0
    begin_ns = time.process_time_ns()
    for step in range(_STEPS):
        now_ns += NS_PER_MS
        for arm in world.arms.values():
            arm.handle_order(FOLLOW, (0.1 if step % 200 < 100 else -0.1, 0.0), now_ns)
        world.step(now_ns)
    whole_us = _measured_us(begin_ns)
    begin_ns = time.process_time_ns()
    for _ in range(_STEPS):
        mujoco.mj_step(world.model, world.data)
    print(f"mj_step {_measured_us(begin_ns):.0f} µs; with both arms' control {whole_us:.0f} µs")


if __name__ == "__main__":
    main()
