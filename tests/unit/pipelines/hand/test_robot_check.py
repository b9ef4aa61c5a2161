"""`kontur-av robot check`: a sound robot passes, and each fault fails its check."""

import importlib.util
from dataclasses import replace
from pathlib import Path

import pytest

from kontur_av.clock import ManualClock
from pipelines.hand.robot_check import RobotCheck

SAMPLE = Path(__file__).resolve().parents[4] / "samples/own_robot.py"
_spec = importlib.util.spec_from_file_location("own_robot", SAMPLE)
own_robot = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(own_robot)
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


class Runaway(own_robot.Mass):
    """Without orders it accelerates."""

    wrote = True

    def write_force(self, x_n, y_n):
        super().write_force(x_n, y_n)
        self.wrote = True

    def advance(self, dt_ns):
        if not self.wrote:
            self.force = (60.0, 0.0)
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


@pytest.mark.parametrize(("robot", "checks"), [(own_robot.Mass, 6), (Placed, 6), (Alone, 7)])
def test_a_sound_robot_passes(robot, checks):
    results = list(RobotCheck(robot(), CLOCK).run())
    assert [one.name for one in results if one.failed] == [], results
    assert len(results) == checks


@pytest.mark.parametrize(
    ("robot", "check"),
    [
        (Eager, "power on"),
        (Deaf, "moves"),
        (Crossed, "moves"),
        (Sliding, "stops"),
        (Runaway, "missed cycles"),
        (Endless, "silence"),
        (Lost, "readings"),
        (Slow, "cycle time"),
        (Broken, "moves"),
    ],
)
def test_each_fault_fails_its_check(robot, check):
    results = list(RobotCheck(robot(), CLOCK).run())
    assert check in [one.name for one in results if one.failed], results
