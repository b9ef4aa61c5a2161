"""`kontur-av robot check`: a sound robot passes, and each fault fails its check."""

from dataclasses import replace

import pytest
from user_parts import Guided, load

from kontur_av.clock import ManualClock
from pipelines.hand.driver_checks import RobotCheck

own_robot = load("own_robot.py")
CLOCK = ManualClock()


class Placed(own_robot.Mass):
    """It takes places."""

    facts = replace(own_robot.Mass.facts, takes="position")

    def write_position(self, x_m, y_m, vx_m_s, vy_m_s):
        if self.active:
            self.vx, self.vy = (x_m - self.x) * 50, (y_m - self.y) * 50

    def advance(self, dt_ns):
        if self.active:
            self.x += self.vx * dt_ns / 1e9
            self.y += self.vy * dt_ns / 1e9


class Eager(own_robot.Mass):
    """It follows though it is not active."""

    def advance(self, dt_ns):
        self.active = True
        self.force = self.force if any(self.force) else (1.0, 0.0)
        super().advance(dt_ns)


class Deaf(own_robot.Mass):
    """It does not move."""

    def write_force(self, x_n, y_n): ...


class Crossed(own_robot.Mass):
    """Its axes are exchanged."""

    def write_force(self, x_n, y_n):
        super().write_force(y_n, x_n)


class Sliding(own_robot.Mass):
    """It goes on when it is switched off."""

    def deactivate(self):
        self.force = (0.0, 0.0)

    def power_off(self):
        super().deactivate()


class Runaway(own_robot.Mass):
    """Without orders it accelerates."""

    wrote = True

    def write_force(self, x_n, y_n):
        super().write_force(x_n, y_n)
        self.wrote = True

    def advance(self, dt_ns):
        if not self.wrote:
            self.force = (10.0, 0.0)
        self.wrote = False
        super().advance(dt_ns)


class Lost(own_robot.Mass):
    """A measurement is missing."""

    reads = 0

    def read(self):
        self.reads += 1
        reading = super().read()
        return reading._replace(y_m=float("nan")) if self.reads % 100 == 0 else reading


class Slow(own_robot.Mass):
    """It takes 0.7 ms for a reading."""

    def read(self):
        CLOCK.advance_ns(700_000)
        return super().read()


class Boastful(own_robot.Mass):
    """Its facts cannot be."""

    facts = replace(own_robot.Mass.facts, half_height_m=-0.1)


class Lively(own_robot.Mass):
    """It adds to the motion, as a controller with a wrong sign does."""

    def advance(self, dt_ns):
        if self.active:
            self.vx, self.vy = self.vx * 1.004, self.vy * 1.004
        super().advance(dt_ns)


class Late(own_robot.Mass):
    """It is switched off 20 ms late."""

    left = 0

    def deactivate(self):
        self.left = 20

    def activate(self):
        self.left = 0
        super().activate()

    def advance(self, dt_ns):
        if self.left:
            self.left -= 1
            if not self.left:
                super().deactivate()
        super().advance(dt_ns)


class Blocking(own_robot.Mass):
    """It waits for its brakes."""

    def deactivate(self):
        CLOCK.advance_ns(30_000_000)
        super().deactivate()


class Stale(own_robot.Mass):
    """While it is moved, it once measures nothing new for 22 ms."""

    left, last = 22, None

    def read(self):
        reading = super().read()
        if self.left and reading.vx_m_s > 0.005:
            self.left -= 1
            self.last = self.last or reading
            return self.last
        return reading


class Ghost(own_robot.Mass):
    """Without power it goes on."""

    def power_off(self): ...


class Alone(own_robot.Mass):
    """Its controller goes on by itself, and stops after 50 ms without a cycle."""

    facts = replace(own_robot.Mass.facts, runs_alone=True)
    patience_ns = 50_000_000
    at_ns = 0

    def advance(self, dt_ns):
        alone_ns = CLOCK.now_ns() - self.at_ns if self.at_ns else dt_ns
        self.at_ns = CLOCK.now_ns()
        for _ in range(min(alone_ns, self.patience_ns) // 1_000_000):
            super().advance(1_000_000)
        if alone_ns > self.patience_ns:
            self.vx = self.vy = 0.0


class Endless(Alone):
    """It does not stop."""

    patience_ns = 10**12


class Broken(own_robot.Mass):
    """Its driver has a fault."""

    def write_force(self, x_n, y_n):
        raise OSError("the bus is gone")


class Wrist(Guided, own_robot.Mass):
    """It has z and yaw, too."""

    def activate(self):
        super().activate()
        for axis in self.axes:
            axis.speed_m_s = 0.0

    def deactivate(self):
        super().deactivate()
        self.release_axes()
        for axis in self.axes:
            axis.speed_m_s = 0.0

    def advance(self, dt_ns):
        super().advance(dt_ns)
        if self.active:
            self.advance_axes(dt_ns)


class LedWrist(Wrist):
    """It takes places."""

    def __init__(self):
        super().__init__()
        self.facts = replace(self.facts, takes="position")

    write_position = Placed.write_position

    def write_more_positions(self, places, speeds):
        if self.active:
            for axis, place in zip(self.axes, places, strict=True):
                axis.speed_m_s = (place * axis.lever_m - axis.place_m) * 50

    def advance(self, dt_ns):
        Placed.advance(self, dt_ns)
        for axis in self.axes:
            axis.place_m += axis.speed_m_s * dt_ns / 1e9


class DeafWrist(Wrist):
    """z has no motor."""

    def write_more_forces(self, forces):
        super().write_more_forces([0.0, *forces[1:]])


class EagerWrist(Wrist):
    """Yaw turns though it is not active."""

    def advance(self, dt_ns):
        super().advance(dt_ns)
        if not self.active:
            self.axes[1].place_m += 1e-5


class LivelyWrist(Wrist):
    """A controller with a wrong sign adds to the motion of z."""

    def advance(self, dt_ns):
        super().advance(dt_ns)
        self.axes[0].speed_m_s *= 1.004


class SlidingWrist(Wrist):
    """z goes on when it is switched off."""

    def deactivate(self):
        speed_m_s = 0.1 * self.axes[0].speed_m_s
        super().deactivate()
        self.axes[0].speed_m_s = speed_m_s

    def advance(self, dt_ns):
        super().advance(dt_ns)
        if not self.active:
            self.axes[0].place_m += self.axes[0].speed_m_s * dt_ns / 1e9


class LateWrist(Wrist):
    """z is switched off 20 ms late."""

    left = 0

    def deactivate(self):
        if self.active:
            z = self.axes[0]
            kept = z.force_n, z.speed_m_s
            super().deactivate()
            z.force_n, z.speed_m_s = kept
            self.left = 20

    def advance(self, dt_ns):
        super().advance(dt_ns)
        if self.left:
            self.left -= 1
            self.axes[0].step(self.axes[0].force_n, dt_ns)
            if not self.left:
                super().deactivate()


class RunawayWrist(Wrist):
    """Without orders yaw accelerates."""

    wrote = True

    def write_more_forces(self, forces):
        super().write_more_forces(forces)
        self.wrote = True

    def advance(self, dt_ns):
        if not self.wrote:
            self.axes[1].speed_m_s += 0.008 * self.active
        self.wrote = False
        super().advance(dt_ns)


class LostWrist(Wrist):
    """A measurement of yaw is missing at times."""

    reads = 0

    def read_more(self):
        self.reads += 1
        z, yaw = super().read_more()
        return [z, yaw._replace(speed=float("nan")) if self.reads % 100 == 0 else yaw]


class FarWrist(Wrist):
    """z says once that it is beyond its range."""

    reads = 0

    def read_more(self):
        self.reads += 1
        z, yaw = super().read_more()
        return [z._replace(place=0.2) if self.reads == 700 else z, yaw]


class StaleWrist(Wrist):
    """While it is moved, z once measures nothing new for 25 ms."""

    left, last = 25, None

    def read_more(self):
        z, yaw = super().read_more()
        if self.left and z.speed > 0.01:
            self.left -= 1
            self.last = self.last or z
            return [self.last, yaw]
        return [z, yaw]


class Shapeless(Wrist):
    """Its facts name axes that they do not describe."""

    def __init__(self):
        super().__init__()
        self.facts = replace(self.facts, more=("z",))


@pytest.mark.parametrize(
    ("robot", "checks"),
    [(own_robot.Mass, 11), (Placed, 11), (Alone, 11), (Wrist, 27), (LedWrist, 27)],
)
def test_a_sound_robot_passes(robot, checks):
    results = list(RobotCheck(robot(), CLOCK).run())
    assert [one.name for one in results if one.failed] == [], results
    assert len(results) == checks


def failed(robot):
    return {one.name for one in RobotCheck(robot(), CLOCK).run() if one.failed}


@pytest.mark.parametrize(
    ("robot", "check"),
    [
        (Boastful, "facts"),
        (Lively, "passivity"),
        (Sliding, "stops"),
        (Late, "emergency stop"),
        (Blocking, "emergency stop"),
        (Runaway, "missed cycles"),
        (Endless, "silence"),
        (Lost, "readings"),
        (Stale, "readings"),
        (Slow, "cycle time"),
        (Ghost, "power off"),
        (DeafWrist, "z moves"),
        (LivelyWrist, "z passivity"),
        (SlidingWrist, "z stops"),
        (LateWrist, "z emergency stop"),
        (RunawayWrist, "yaw missed cycles"),
        (LostWrist, "yaw readings"),
        (FarWrist, "z readings"),
        (StaleWrist, "z readings"),
    ],
)
def test_each_fault_fails_its_check_alone(robot, check):
    assert failed(robot) == {check}


@pytest.mark.parametrize(
    ("robot", "check"),
    [
        (Eager, "power on"),
        (EagerWrist, "yaw power on"),
        (Deaf, "moves"),
        (Crossed, "moves"),
        (Broken, "moves"),
    ],
)
def test_a_fault_of_much_fails_its_check(robot, check):
    assert check in failed(robot)


def test_axes_that_are_not_described_are_said():
    facts, *_ = RobotCheck(Shapeless(), CLOCK).run()
    assert "more is ('z',): give AxisFacts" in facts.trouble
