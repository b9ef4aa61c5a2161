"""The bilateral exchange with a deadband: as passive as without it, and almost as good."""

from math import hypot
from random import Random

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from kontur_av.clock import NS_PER_MS
from telepresence.haptics.bilateral import JoystickSide, RobotSide
from telepresence.haptics.loop import joystick_link, robot_link


class Exchange:
    """Both sides, and a path that delays, loses and reorders; one cycle a millisecond."""

    def __init__(self, *, deadband, delay_ms=0.0, jitter_ms=0.0, loss=0.0, seed=0):
        self.joystick_side = JoystickSide(link=joystick_link(deadband=deadband))
        self.robot_side = RobotSide(link=robot_link(deadband=deadband))
        self.tip, self.force_n, self.contacts = [], [], 0
        self._delay_ns, self._jitter_ns = delay_ms * NS_PER_MS, jitter_ms * NS_PER_MS
        self._loss, self._random = loss, Random(seed)
        self._under_way = {self.joystick_side: [], self.robot_side: []}

    def run(self, cycles, gap=range(0)):
        """gap: cycles in which the path loses everything."""
        touching = False
        for k in range(cycles):
            now_ns = k * NS_PER_MS
            for side, waiting in self._under_way.items():
                for due in sorted(sample for sample in waiting if sample[0] <= now_ns):
                    waiting.remove(due)
                    side.handle_datagram(due[1], now_ns)
            for side, peer in (
                (self.robot_side, self.joystick_side),
                (self.joystick_side, self.robot_side),
            ):
                side.handle_cycle(now_ns, NS_PER_MS)
                sample = side.poll_transmit(now_ns)
                if sample is None or k in gap or self._random.random() < self._loss:
                    continue
                late_ns = self._delay_ns + self._random.random() * self._jitter_ns
                self._under_way[peer].append((now_ns + round(late_ns), sample))
            robot = self.robot_side.robot
            self.tip.append((robot.x_m, robot.y_m))
            self.force_n.append(hypot(self.joystick_side.force_x_n, self.joystick_side.force_y_n))
            self.contacts += robot.contact and not touching
            touching = robot.contact
        return self


@given(
    delay_ms=st.floats(0, 500),
    jitter_ms=st.floats(0, 50),
    loss=st.floats(0, 0.4),
    gap=st.tuples(st.integers(500, 1500), st.integers(0, 1000)),
    seed=st.integers(0, 1000),
)
@settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_no_port_ever_gives_out_what_was_not_granted(delay_ms, jitter_ms, loss, gap, seed):
    exchange = Exchange(deadband=True, delay_ms=delay_ms, jitter_ms=jitter_ms, loss=loss, seed=seed)
    begin, length = gap
    exchange.run(3000, gap=range(begin, begin + length))
    for side, peer in (
        (exchange.joystick_side, exchange.robot_side),
        (exchange.robot_side, exchange.joystick_side),
    ):
        report = side.report()
        assert report.least_uj >= -1
        # By the ends' own totals, independent of the observers: what left has entered before.
        assert report.energy_out_uj <= peer.report().energy_in_uj + (report.energy_in_uj + 1)
    # With a delay of half a second and a gap of 1 s, nobody rests long enough in these 3 s.
    if delay_ms < 200:
        assert exchange.joystick_side.link.deadband.left_out > 0
    assert max(exchange.force_n) < 20


@pytest.mark.parametrize("delay_ms", [0, 10])
def test_forces_and_motions_are_nearly_the_same(delay_ms):
    every = Exchange(deadband=False, delay_ms=delay_ms).run(12_000)
    some = Exchange(deadband=True, delay_ms=delay_ms).run(12_000)
    assert some.contacts == every.contacts > 3
    off_m = [hypot(a[0] - b[0], a[1] - b[1]) for a, b in zip(every.tip, some.tip, strict=True)]
    assert sum(off_m) / len(off_m) < 0.3e-3
    off_n = [abs(a - b) for a, b in zip(every.force_n, some.force_n, strict=True)]
    # On average, because a contact one cycle earlier differs by the whole force for a moment.
    assert sum(off_n) / len(off_n) < 0.2
    # Four fifths of the robot's samples are not sent, and half of the joystick's.
    assert some.robot_side.link.sent_figures().left_out > 0.75 * 12_000
    assert some.joystick_side.link.sent_figures().left_out > 0.4 * 12_000
    assert some.joystick_side.link.lost == some.robot_side.link.lost == 0


def test_two_lost_samples_in_a_row_are_no_silence():
    for start in range(500, 506):
        exchange = Exchange(deadband=True, delay_ms=5).run(600, gap=range(start, start + 12))
        assert exchange.joystick_side.link.lost >= 2
        found = list(iter(exchange.joystick_side.link.next_event, None))
        assert len(found) == 1, "once, at the beginning: it was never lost"
