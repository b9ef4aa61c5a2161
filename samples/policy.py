"""A policy at the handle: it reaches three places in turn, and stays at each for a second.

kontur-av stream --setup taskboard --joystick page &
python samples/policy.py                          then press O at the page, or: tc joystick policy

Take the handle at the page, and it lets go. A learned policy has the same method: it gets the
picture with its age, the robot's place by axis and the task, and returns one action or a chunk.
"""

from collections.abc import Mapping
from math import hypot

from pipelines import JoinedSession, Observation

PLACES_M = ((0.03, 0.02), (-0.03, 0.02), (0.0, -0.03))
NEAR_M, STAYS_NS = 0.005, 1_000_000_000


class Reach:
    """Goes from place to place while it drives, and aims at where it is otherwise."""

    def __init__(self) -> None:
        self.reached, self.since_ns = 0, 0

    def step(self, seen: Observation) -> Mapping[str, float]:
        if not seen.drives:
            return seen.robot
        x_m, y_m = PLACES_M[self.reached % len(PLACES_M)]
        if hypot(seen.robot["x"] - x_m, seen.robot["y"] - y_m) > NEAR_M:
            self.since_ns = seen.now_ns
        elif seen.now_ns - self.since_ns > STAYS_NS:
            self.reached += 1
            print(f"reached {x_m:g} m, {y_m:g} m", flush=True)
        return {"x": x_m, "y": y_m}


if __name__ == "__main__":
    with JoinedSession() as session:
        session.drive(Reach(), hz=30)
