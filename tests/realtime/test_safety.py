"""Orders to stop outlive the processes that took them, and motion needs a new press."""

import os
import signal
import time

import pytest
from robot_tip import Tip
from running_session import BOARD, eventually, restarted

from pipelines.hand.hand_topics import JOYSTICK_STATE_TOPIC
from pipelines.session.mission_messages import ROBOT_STATUS_TOPIC
from telepresence.haptics.device.states import JoystickState

#: Cycles of the robot's loop that would show a motion.
CYCLES = 1000
#: A joystick that was halted when its process ended begins so.
HELD = (JoystickState.STANDBY, JoystickState.HALTED)


class Watched:
    """The processes of a session that move the robot, and what they say."""

    def __init__(self, session, bus):
        self.session, self.pids, self.tip = session, session.pids(), Tip(bus)
        self._readers = {
            "joystick": bus.reader(JOYSTICK_STATE_TOPIC),
            "robot": bus.reader(ROBOT_STATUS_TOPIC),
        }

    def kill(self, name):
        """Kill a process; wait until its next start says what it does."""
        self.session.kill(self.pids, name)
        self._readers[name].latest_octets()
        self.newest(name)

    def newest(self, name):
        octets = eventually(self._readers[name].latest_octets, f"what {name} says")
        topic = ROBOT_STATUS_TOPIC if name == "robot" else JOYSTICK_STATE_TOPIC
        return topic.unpack(octets)

    def stays_halted(self):
        """Whether the joystick waits for an order to start, and the robot does not move."""
        return self.tip.holds(CYCLES) and self.newest("joystick").state in HELD


@pytest.mark.rule("S10")
@pytest.mark.rule("S6")
def test_a_halt_outlives_the_joystick_and_a_stop_outlives_both(start, monkeypatch):
    session = start(BOARD)
    with session.bus(monkeypatch) as bus:
        watched = Watched(session, bus)
        tip = watched.tip
        tip.wait_until_it_moves()
        assert session.ask("tc", "joystick", "halt").returncode == 0
        tip.rests()
        watched.kill("joystick")
        assert watched.stays_halted()
        assert session.ask("tc", "joystick", "start").returncode == 0
        tip.wait_until_it_moves()

        stopped = session.ask("stop")
        assert stopped.returncode == 0 and "emergency stop by" in stopped.stdout
        tip.rests()
        watched.kill("robot")
        watched.kill("joystick")
        assert tip.holds(CYCLES) and watched.newest("robot").stopped
        refused = session.ask("tc", "robot", "power_on")
        assert refused.returncode == 1 and "emergency stop" in refused.stdout + refused.stderr
        assert session.ask("stop", "--release").returncode == 0
        assert tip.holds(CYCLES)
        assert session.ask("tc", "robot", "power_on").returncode == 0
        # The hand is simulated, and presses anew.
        tip.wait_until_it_moves()
    report = session.finish()
    assert report["safety"]["presses"] >= 1
    assert report["safety"]["hold"] == ""


@pytest.mark.rule("S2")
@pytest.mark.rule("S6")
def test_a_stop_outlives_its_killed_session_and_after_a_stall_the_robot_waits_for_a_new_press(
    start, monkeypatch
):
    first = start(BOARD)
    first.pids()
    eventually(lambda: first.ask("stop").returncode == 0, "the robot's answer to a stop")
    os.killpg(first.process.pid, signal.SIGKILL)
    first.process.wait()
    session = start(BOARD)
    with session.bus(monkeypatch) as bus:
        watched = Watched(session, bus)
        tip = watched.tip
        assert tip.holds(CYCLES) and watched.newest("robot").stopped
        assert "the emergency stop by a terminal of" in session.errors()
        assert session.ask("stop", "--release").returncode == 0
        assert session.ask("tc", "robot", "power_on").returncode == 0

        def holds(name):
            tip.wait_until_it_moves()
            os.kill(watched.pids[name], signal.SIGSTOP)
            # Longer than after which a new press is needed.
            time.sleep(0.5)
            begin_s = time.monotonic()
            os.kill(watched.pids[name], signal.SIGCONT)
            tip.place()
            # The simulated hand lets go for half a second, before it presses anew. A test that
            # was itself stalled for as long looks again.
            held = tip.holds(300)
            assert held or time.monotonic() - begin_s > 0.5, name
            return held

        for name in ("joystick", "robot"):
            eventually(lambda one=name: holds(one), f"a look at the stalled {name}")
        tip.wait_until_it_moves()
    report = session.finish()
    # A stall of the machine needs one, too.
    assert report["safety"]["presses"] >= 3
    # The joystick has calibrated itself once.
    joystick = report["joystick"]
    log = [entry["state"] for entry in joystick["log"]]
    assert log.count("calibrated") == 1 and log[-1] == joystick["state"] == "application"
    assert joystick["temperature_c"] > 20
    assert restarted(report) == {}
    assert list((session.directory / "state").rglob("*.armed")) != []
