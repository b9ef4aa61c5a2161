"""A hand from a page in a live session: it moves the robot, and the robot stops without it."""

import time
from itertools import count
from math import cos, pi

import pytest
from running_session import PATIENCE_S, eventually

from kontur_av.clock import NS_PER_MS, NS_PER_S, MonotonicClock
from kontur_av.media import CaptureStamp
from pipelines.hand.hand_topics import (
    INPUT_OCTETS,
    REQUEST_OCTETS,
    HandRequest,
    pack_input,
    pack_request,
    unpack_status,
)
from pipelines.hand.haptic_trace import BLOCK_ROWS, DEAD_MAN, rows_of
from pipelines.session.robot_state import unpack_state
from pipelines.session.topology import (
    HAND_INPUT_TOPIC,
    HAND_REQUEST_TOPIC,
    JOYSTICK_STATE_TOPIC,
    ROBOT_TOPIC,
    ROBOT_TRACE_TOPIC,
)
from telepresence.haptics.device.page import PageInput
from telepresence.haptics.device.states import JoystickEvent, JoystickState

pytestmark = pytest.mark.realtime

#: 250 Hz.
PERIOD_NS = 4 * NS_PER_MS


class Page:
    """What the process of the operator's page reads and writes."""

    def __init__(self, bus):
        self.clock = MonotonicClock()
        self.numbers = count(1)
        self.hand = bus.writer(HAND_INPUT_TOPIC, max_octets=INPUT_OCTETS, wake=False)
        self.requests = bus.writer(HAND_REQUEST_TOPIC, max_octets=REQUEST_OCTETS, wake=False)
        self.readers = {
            topic: bus.reader(topic, depth=8)
            for topic in (ROBOT_TOPIC, ROBOT_TRACE_TOPIC, JOYSTICK_STATE_TOPIC)
        }

    def stamp(self, now_ns):
        return CaptureStamp(now_ns, 0, "page")

    def point(self, x, y):
        now_ns = self.clock.now_ns()
        hand = PageInput(True, x, y, 0, next(self.numbers), now_ns)
        self.hand.publish_octets(pack_input(hand), self.stamp(now_ns))

    def ask(self, event):
        number = next(self.numbers)
        request = pack_request(HandRequest(number, event))
        self.requests.publish_octets(request, self.stamp(self.clock.now_ns()))
        return eventually(lambda: self.answer(number), f"the answer to {event.value}")

    def answer(self, number):
        status = self.status()
        return status if status is not None and status.answered == number else None

    def status(self):
        data = self.newest(JOYSTICK_STATE_TOPIC)
        return None if data is None else unpack_status(data)

    def is_in(self, state):
        status = self.status()
        return status is not None and status.state == state

    def robot(self):
        return unpack_state(eventually(lambda: self.newest(ROBOT_TOPIC), "a state of the robot"))

    def newest(self, topic):
        lease = self.readers[topic].latest()
        if lease is None:
            return None
        with lease:
            return lease.octets()

    def rows(self):
        return rows_of(eventually(lambda: self.newest(ROBOT_TRACE_TOPIC), "a block of the trace"))

    def move_until(self, done):
        """Move the hand to and fro, until the robot's state is as wanted."""
        began_ns = due_ns = self.clock.now_ns()
        while due_ns - began_ns < PATIENCE_S * NS_PER_S:
            due_ns += PERIOD_NS
            self.clock.sleep_until_ns(due_ns)
            seconds = (due_ns - began_ns) / NS_PER_S
            self.point(0.3 * (cos(2 * pi * 0.5 * seconds) - 1.0), 0.0)
            data = self.newest(ROBOT_TOPIC)
            if data is not None and done(unpack_state(data)):
                return
        pytest.fail("the robot does not follow the hand")


def test_the_robot_follows_a_pages_hand_and_stops_with_it(start, monkeypatch):
    session = start("taskboard", "--page", "8330", "--joystick", "page")
    session.pids()
    with session.bus(monkeypatch) as bus:
        page = Page(bus)
        eventually(lambda: page.is_in(JoystickState.APPLICATION), "the application")
        still = page.robot()
        assert abs(still.x_m) < 0.01
        page.move_until(lambda state: state.x_m < -0.05)
        page.move_until(lambda state: state.x_m > -0.02)
        # The hand is gone in the middle of its movement.
        eventually(lambda: not page.rows()["flags"][-1] & DEAD_MAN, "the release")
        released_ns = page.robot().time_ns
        eventually(lambda: page.robot().time_ns > released_ns + NS_PER_S, "a second")
        rest = page.robot()
        eventually(lambda: page.robot().time_ns > rest.time_ns + NS_PER_S, "another second")
        after = page.robot()
        assert (after.x_m, after.y_m) == pytest.approx((rest.x_m, rest.y_m), abs=1e-4)
        rows = page.rows()
        assert len(rows) == BLOCK_ROWS and rows["x_m"][-1] == pytest.approx(after.x_m, abs=1e-4)

        # A halt holds against every input, until a person starts again.
        assert page.ask(JoystickEvent.HALT).state == JoystickState.HALTED
        for _ in range(100):
            page.point(0.9, 0.9)
            time.sleep(PERIOD_NS / NS_PER_S)
        halted = page.robot()
        assert (halted.x_m, halted.y_m) == pytest.approx((rest.x_m, rest.y_m), abs=1e-4)
        refused = page.ask(JoystickEvent.ACKNOWLEDGE)
        assert "not in the state halted" in refused.refusal
        assert page.ask(JoystickEvent.START).state == JoystickState.APPLICATION
        page.move_until(lambda state: state.x_m < rest.x_m - 0.02)
    _, report = session.interrupt()
    assert report["joystick"]["device"] == "browser page"
    assert report["joystick"]["dead_man_released"] >= 1
    assert [entry["event"] for entry in report["joystick"]["log"]][-3:] == [
        "halt",
        "resume",
        "start",
    ]
