"""The samples' robots of MuJoCo on virtual time: SpaceJustin's two arms, and a stranger's arm."""

import sys
from math import hypot
from pathlib import Path

import pytest

from kontur_av.clock import NS_PER_MS, ManualClock
from pipelines.hand.driver_checks import RobotCheck
from telepresence.tasks.definitions import Operation
from telepresence.tasks.kernel import TICK_NS, OperationEnded, OtherHand, TopKernel, View
from telepresence.tasks.panel_picture import DARK
from telepresence.tasks.scores import ScoreKeeper
from telepresence.tasks.task_files import built_in_tasks
from telepresence.tmtc.k2aci import TaskResult

pytest.importorskip("mujoco")
sys.path.append(str(Path(__file__).resolve().parents[2] / "samples"))

from mujoco_robot import LeftArm, SpaceJustin
from mujoco_robot.messages import BRAKE, FOLLOW, reading_of
from mujoco_robot.physics import World

#: A hand that leads a tip (N/m, N s/m, N).
STIFFNESS, DAMPING, MOST_N = 600.0, 40.0, 15.0


class Bench:
    """Both arms in one physics, each led to a place; a reading of both after each step."""

    def __init__(self):
        self.world, self.now_ns = World(), 0
        self.places = {"right": (0.06, 0.0), "left": (-0.06, 0.0)}
        self.step()

    def read(self, side):
        return reading_of(self.world.arms[side].state)

    def force(self, side):
        one, (x_m, y_m) = self.read(side), self.places[side]
        force = (
            STIFFNESS * (x_m - one.x_m) - DAMPING * one.vx_m_s,
            STIFFNESS * (y_m - one.y_m) - DAMPING * one.vy_m_s,
        )
        return tuple(max(-MOST_N, min(MOST_N, value)) for value in force)

    def step(self):
        self.now_ns += NS_PER_MS
        for side, arm in self.world.arms.items():
            arm.handle_order(FOLLOW, self.force(side), self.now_ns)
        self.world.step(self.now_ns)

    def lead(self, seconds, **places):
        self.places.update(places)
        for _ in range(round(seconds * 1000)):
            self.step()
        return self.read("right"), self.read("left")


class Driven:
    """One arm as a `RobotDevice`, in step with the caller."""

    def __init__(self, kind, side):
        self.capabilities, self._side = kind.capabilities, side
        self._bench, self._order, self._age = Bench(), (BRAKE, (0.0, 0.0)), 0

    def configure(self): ...

    def power_on(self): ...

    def power_off(self):
        self.deactivate()

    def activate(self):
        self._order = FOLLOW, (0.0, 0.0)

    def deactivate(self):
        self._order = BRAKE, (0.0, 0.0)

    def write_force(self, x_n, y_n):
        if self._order[0] == FOLLOW:
            self._order, self._age = (FOLLOW, (x_n, y_n)), 0

    def advance(self, dt_ns):
        bench = self._bench
        # As `arm.py` drops what is older than 50 cycles.
        self._age += 1
        if self._order[0] == FOLLOW and self._age > 50:
            self._order = BRAKE, (0.0, 0.0)
        bench.now_ns += dt_ns
        bench.world.arms[self._side].handle_order(*self._order, bench.now_ns)
        bench.world.step(bench.now_ns)

    def read(self):
        return self._bench.read(self._side)


@pytest.mark.parametrize(("kind", "side"), [(SpaceJustin, "right"), (LeftArm, "left")])
def test_each_arm_passes_the_checks_of_a_robot(kind, side):
    results = list(RobotCheck(Driven(kind, side), ManualClock()).run())
    assert [result.name for result in results if result.failed] == []


def test_a_strangers_arm_passes_the_checks_of_a_robot():
    pytest.importorskip("gymnasium_robotics")
    from strangers_arm import Fetch

    results = list(RobotCheck(Fetch(), ManualClock()).run())
    assert [result.name for result in results if result.failed] == []


def test_the_hand_reaches_its_workspace_and_touches_the_rail():
    bench = Bench()
    bench.lead(1.0, left=(-0.15, 0.05))
    for x_m, y_m in ((0.14, -0.1), (-0.14, -0.02), (-0.14, 0.1), (-0.14, 0.0)):
        right, _ = bench.lead(1.5, right=(x_m, y_m))
        assert hypot(right.x_m - x_m, right.y_m - y_m) < 0.005
    bench.lead(1.0, right=(0.1, 0.0))
    right, _ = bench.lead(1.0, right=(0.1, 0.05))
    assert right.contact and right.push_y_n < -5.0
    assert abs(right.push_x_n) < 1.0
    assert 0.03 < right.y_m < 0.04


def test_hands_that_meet_fast_break_no_limit_of_force():
    bench, most_n = Bench(), 0.0
    for passed_ms in range(1, 601):
        met_s = min(passed_ms, 400) / 1000
        readings = bench.lead(
            0.001, right=(0.06 - 0.25 * met_s, 0.0), left=(0.15 * met_s - 0.06, 0.0)
        )
        most_n = max(most_n, *(hypot(reading.push_x_n, reading.push_y_n) for reading in readings))
    assert 10.0 < most_n < SpaceJustin.capabilities.force_limit_n


def test_an_arm_whose_driver_is_silent_brakes():
    bench = Bench()
    bench.lead(0.2, right=(0.14, 0.0))
    assert bench.read("right").vx_m_s > 0.1
    for _ in range(300):
        bench.now_ns += NS_PER_MS
        bench.world.step(bench.now_ns)
    assert abs(bench.read("right").vx_m_s) < 0.001


def held(kernel, bench, keeper, seconds, **places):
    """Lead both hands there while the kernel executes its Elemops; return the readings."""
    for _ in range(round(seconds * 1e9 / TICK_NS)):
        right, left = bench.lead(TICK_NS / 1e9, **places)
        push_n, other_n = (hypot(one.push_x_n, one.push_y_n) for one in (right, left))
        keeper.handle_robot(right.x_m, right.y_m, push_n, kernel.elemop, DARK, other_n)
        other = OtherHand(x_m=left.x_m, y_m=left.y_m, push_n=other_n, holds=left.holds)
        view = View(x_m=right.x_m, y_m=right.y_m, push_n=push_n, holds=right.holds, other=other)
        kernel.handle_view(view, bench.now_ns)
    return right, left


def both(*elemops):
    """Return a kernel that executes these Elemops, and what is at both hands."""
    kernel, bench = TopKernel(), Bench()
    steps = tuple(built_in_tasks().elemops[name] for name in elemops)
    kernel.start(Operation("both", steps), bench.now_ns)
    return kernel, bench, ScoreKeeper()


def results(kernel):
    news = iter(kernel.next_event, None)
    return [event.result for event in news if isinstance(event, OperationEnded)]


def test_both_hands_feel_a_handshake_with_the_same_force_and_finish_its_task():
    kernel, _, keeper = table = both("meetHands")
    held(*table, 2.0, right=(0.0, 0.0), left=(-0.1, 0.0))
    assert not results(kernel)
    right, left = held(*table, 2.0, left=(0.03, 0.0))
    assert right.contact and left.contact
    assert hypot(right.x_m - left.x_m, right.y_m - left.y_m) < 0.02
    assert right.push_x_n > 3.0
    assert left.push_x_n == pytest.approx(-right.push_x_n, abs=0.1)
    assert results(kernel) == [TaskResult.FINISHED]
    scores = keeper.report()
    assert scores.force_max_n > 3.0
    assert scores.other_force_max_n == pytest.approx(scores.force_max_n, abs=0.5)


def test_the_ball_goes_from_the_right_hand_to_the_left_one():
    kernel, *_ = table = both("takeBall", "passBall")
    held(*table, 1.0, right=(0.1, 0.0))
    held(*table, 1.0, right=(0.1, -0.095))
    right, left = held(*table, 1.5, right=(0.0, -0.095))
    assert right.holds and not left.holds
    right, left = held(*table, 1.5, right=(0.03, 0.0))
    # It carries the ball's weight.
    assert right.holds and right.push_y_n == pytest.approx(-0.08 * 9.81, abs=0.2)
    right, left = held(*table, 2.5, right=(0.0, 0.0), left=(0.0, 0.0))
    assert left.holds and not right.holds
    assert results(kernel) == [TaskResult.FINISHED]
    _, left = held(*table, 1.5, right=(0.1, 0.0), left=(-0.1, 0.0))
    assert left.holds and left.push_y_n == pytest.approx(-0.08 * 9.81, abs=0.2)
