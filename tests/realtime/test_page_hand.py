"""A hand from a page in a live session: it moves the robot, and the robot stops without it."""

import time
from math import cos, pi

import pytest
from page_hand import PageHand
from running_session import PATIENCE_S, eventually

from kontur_av.clock import NS_PER_MS, NS_PER_S
from pipelines.hand.haptic_trace import BLOCK_ROWS, DEAD_MAN
from pipelines.session.topic_ends import unpack_state
from pipelines.session.topology import ROBOT_TOPIC
from telepresence.haptics.device.states import JoystickEvent, JoystickState

pytestmark = pytest.mark.realtime

#: 250 Hz.
PERIOD_NS = 4 * NS_PER_MS


class Page(PageHand):
    """A hand that moves to and fro."""

    def move_until(self, done):
        """Move the hand, until the robot's state is as wanted."""
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
        # The button was held all the time, so this is no new press.
        for number in range(250):
            page.point(0.9 - 0.002 * number, 0.9)
            time.sleep(PERIOD_NS / NS_PER_S)
        held = page.robot()
        assert (held.x_m, held.y_m) == pytest.approx((rest.x_m, rest.y_m), abs=1e-4)
        page.point(0.0, 0.0, dead_man=False)
        eventually(lambda: not page.rows()["flags"][-1] & DEAD_MAN, "the release")
        page.move_until(lambda state: state.x_m < rest.x_m - 0.02)
    _, report = session.interrupt()
    assert report["joystick"]["device"] == "browser page"
    assert report["joystick"]["dead_man_released"] >= 1
    assert [entry["event"] for entry in report["joystick"]["log"]][-3:] == [
        "halt",
        "resume",
        "start",
    ]
