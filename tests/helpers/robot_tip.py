"""Where the robot's tip is in a running session."""

import time
from math import dist

from running_session import eventually

from kontur_av.clock import NS_PER_MS
from pipelines.session.mission_messages import ROBOT_TOPIC

#: A robot that holds still gives way to what it touches, and comes to rest.
STILL_M = 0.002


class Tip:
    """Looks at the robot's tip."""

    def __init__(self, bus):
        self._reader = bus.reader(ROBOT_TOPIC)
        self._state = None

    def state(self):
        lease = eventually(self._reader.latest, "a state of the robot")
        with lease:
            return ROBOT_TOPIC.unpack(lease.octets())

    def place(self):
        state = self.state()
        return state.x_m, state.y_m

    def way(self, seconds):
        """Return the largest distance (m) from where it was at first, on an axis."""
        x_m, y_m = self.place()
        end_s, most_m = time.monotonic() + seconds, 0.0
        while time.monotonic() < end_s:
            place = self.place()
            most_m = max(most_m, abs(place[0] - x_m), abs(place[1] - y_m))
        return most_m

    def holds(self, cycles):
        """Whether it has not moved while the robot's loop went through so many cycles of 1 ms."""
        first = self.state()
        while (state := self.state()).time_ns < first.time_ns + cycles * NS_PER_MS:
            if max(abs(state.x_m - first.x_m), abs(state.y_m - first.y_m)) >= STILL_M:
                return False
        return True

    def rests(self):
        """Wait until it has come to rest."""
        eventually(lambda: self.holds(200), "the rest of the robot")

    def wait_until_it_moves(self):
        place = self.place()
        eventually(lambda: dist(self.place(), place) > 0.02, "a motion of the robot")
