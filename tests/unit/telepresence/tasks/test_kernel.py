"""The kernel: Elemops in order, end conditions, time-outs, and what ends a run."""

from dataclasses import replace

import pytest

from kontur_av.clock import NS_PER_S
from telepresence.haptics.board import LIGHTS_M
from telepresence.tasks import kernel
from telepresence.tasks.kernel import ChooseCamera, ElemopBegun, Record, ShowPicture, View
from telepresence.tasks.panel_picture import DARK
from telepresence.tasks.positions import curve_points
from telepresence.tasks.task_files import built_in_tasks
from telepresence.tmtc.k2aci import TaskResult

CATALOGUE = built_in_tasks()


class Obedient:
    """Does each order at once, and puts the tip where `tip` says."""

    def __init__(self, operation, **view):
        self.kernel, self.view, self.now_ns = kernel.TopKernel(), View(**view), 0
        self.kernel.start(CATALOGUE.operations[operation], 0)
        self.orders, self.events = [], []
        self.deaf_to = ()
        self.tip = lambda elemop, now_ns: None

    def run(self, seconds=120.0):
        until_ns = self.now_ns + round(seconds * NS_PER_S)
        while True:
            while (order := self.kernel.poll_transmit(self.now_ns)) is not None:
                self.orders.append(order)
                if not isinstance(order, self.deaf_to):
                    self.change(**self.obeyed(order))
            self.events += iter(self.kernel.next_event, None)
            due_ns = self.kernel.poll_timeout()
            if due_ns is None or due_ns >= until_ns:
                self.now_ns = until_ns
                return
            self.now_ns = due_ns
            place = self.tip(self.kernel.elemop, due_ns)
            if place is not None:
                self.change(x_m=place[0], y_m=place[1])
            self.kernel.handle_view(self.view, due_ns)

    def change(self, **changes):
        self.view = replace(self.view, **changes)

    def obeyed(self, order):
        """What an order changes."""
        match order:
            case kernel.PowerRobot(on):
                return {"powered": on}
            case kernel.ControlRobot(mode):
                return {"mode": mode}
            case kernel.MoveRobot(x_m, y_m):
                return {"goal_m": (x_m, y_m), "x_m": x_m, "y_m": y_m}
            case ChooseCamera(name):
                return {"camera": name}
            case Record(on):
                return {"recording": on}
        return {"shown": True}

    @property
    def begun(self):
        return [event.elemop for event in self.events if isinstance(event, ElemopBegun)]

    @property
    def end(self):
        (end,) = [event for event in self.events if isinstance(event, kernel.OperationEnded)]
        return end


def aim(elemop, now_ns):
    led = getattr(elemop, "led", None)
    return None if led is None else LIGHTS_M[led]


@pytest.mark.parametrize("operation", ["startAiming", "execAiming"])
def test_elemops_run_in_their_order_one_at_a_time(operation):
    robot = Obedient(operation)
    robot.tip = aim
    robot.run()
    names = [elemop.name for elemop in CATALOGUE.operations[operation].elemops]
    assert robot.begun == names
    for event, name in zip(robot.events[:-1], (name for name in names for _ in "ab"), strict=True):
        assert event.elemop == name and getattr(event, "done", True)
    assert robot.end.result is TaskResult.FINISHED
    assert robot.kernel.poll_timeout() is None
    assert Record(operation == "startAiming") in robot.orders


def test_a_place_is_reached_after_it_was_held_for_half_a_second():
    robot = Obedient("execAiming")
    away = (LIGHTS_M[7][0] + 0.006, LIGHTS_M[7][1])
    since = []

    def tip(elemop, now_ns):
        if elemop.name != "checkPos7":
            return None
        since.append(now_ns)
        return away if len(since) == 5 else LIGHTS_M[7]

    robot.tip = tip
    robot.run(20)
    # 4 ticks, one away, and then from the sixth on 0.5 s.
    assert len(since) == 5 + 6


def test_a_run_that_takes_too_long_ends_with_the_robot_off_and_the_record_stopped():
    robot = Obedient("execAiming")
    robot.change(recording=True)
    robot.run()
    assert robot.begun[-4:] == ["checkPos7", "powerOff", "darkLeds", "stopLogging"]
    assert robot.end.result is TaskResult.TIMED_OUT and "checkPos7" in robot.end.reason
    assert not robot.view.powered and not robot.view.recording
    assert 60 * NS_PER_S <= robot.end.now_ns < 62 * NS_PER_S


@pytest.mark.parametrize(
    ("change", "result"),
    [
        ({"signal": False}, TaskResult.LOST_SIGNAL),
        ({"fault": "too hot"}, TaskResult.ABORTED),
        ({"halted": True}, TaskResult.ABORTED),
        (None, TaskResult.ABORTED),
    ],
)
@pytest.mark.parametrize("operation", ["startAiming", "execAiming"])
def test_whatever_goes_wrong_at_any_elemop_ends_the_run_with_the_robot_off(
    operation, change, result
):
    for begun in range(1, len(CATALOGUE.operations[operation].elemops)):
        robot = Obedient(operation)
        robot.tip = aim
        while len(robot.begun) < begun:
            robot.run(0.1)
        if change is None:
            robot.kernel.abort("the experimenter aborts", robot.now_ns)
        else:
            robot.change(**change)
        robot.run(1)
        assert robot.end.result is result and robot.end.reason
        assert not robot.view.powered and not robot.view.recording
        shown = [order.picture for order in robot.orders if isinstance(order, ShowPicture)]
        assert shown[-1] == DARK


def test_orders_that_nobody_carries_out_are_repeated_and_end_as_timed_out():
    robot = Obedient("startAiming")
    robot.deaf_to = (ChooseCamera,)
    robot.run(30)
    assert robot.orders.count(ChooseCamera("stereo")) == 10
    assert robot.end.result is TaskResult.TIMED_OUT and "selectCamTcp" in robot.end.reason


def test_a_kernel_that_was_stopped_ends_the_run():
    robot = Obedient("execAiming")
    robot.run(2)
    robot.now_ns += 5 * NS_PER_S
    robot.kernel.handle_view(robot.view, robot.now_ns)
    robot.run(1)
    assert robot.end.result is TaskResult.ABORTED


def test_a_curve_is_followed_when_nearly_all_of_it_was_visited():
    points = curve_points(CATALOGUE.elemops["followContour"].curve)
    results = []
    for share in (0.9, 1.0):
        robot = Obedient("execContour")
        way = iter(points[: round(len(points) * share)])
        robot.tip = lambda elemop, now_ns, way=way: (
            next(way, None) if elemop.name == "followContour" else None
        )
        robot.run(200)
        results.append(robot.end.result)
    assert results == [TaskResult.TIMED_OUT, TaskResult.FINISHED]


def test_a_spring_is_to_be_held_at_its_force():
    robot = Obedient("execSpring")
    robot.change(push_n=5.0)
    robot.run(5)
    assert robot.kernel.elemop is CATALOGUE.elemops["pullSpring"]
    robot.change(push_n=3.2)
    robot.run(5)
    assert robot.end.result is TaskResult.FINISHED


def hand(x_m=0.0, push_n=0.0, holds=False):
    return kernel.OtherHand(x_m=x_m, y_m=0.0, push_n=push_n, holds=holds)


@pytest.mark.parametrize(
    ("push_n", "other", "meets"),
    [
        (2.0, hand(0.01, 2.0), True),
        (2.0, hand(0.01, 0.5), False),
        (0.5, hand(0.01, 2.0), False),
        (2.0, hand(0.2, 2.0), False),
        (2.0, None, False),
    ],
)
def test_hands_meet_while_both_are_pushed_near_each_other(push_n, other, meets):
    robot = Obedient("execHandshake", push_n=push_n, other=other)
    robot.run(20.0)
    assert ("darkLeds" in robot.begun) is meets


def test_the_ball_is_passed_once_the_partners_hand_alone_holds_it():
    robot = Obedient("execBall")
    for holds, other, begun in (
        (False, False, "takeBall"),
        (True, False, "passBall"),
        (True, True, "passBall"),
        (False, True, "powerOff"),
    ):
        robot.change(holds=holds, other=hand(holds=other))
        robot.run(5.0)
        assert robot.begun[-1] == begun
    assert robot.end.result is TaskResult.FINISHED
