"""Orders to stop outlive the processes that took them, and motion needs a new press."""

import os
import signal
import time

from robot_tip import STILL_M, Tip
from running_session import eventually


def restarted(session, name, pids, number):
    """Send a process a signal that ends it; wait for its successor."""
    os.kill(pids[name], number)
    others = {pid for other, pid in pids.items() if other != name}
    (pids[name],) = eventually(
        lambda: [pid for pid in session.children() if pid not in (*others, pids[name])],
        f"the restart of {name}",
    )


def test_a_halt_outlives_the_joystick_and_a_stop_outlives_both(start, monkeypatch):
    session = start("taskboard")
    pids = session.pids()
    with session.bus(monkeypatch) as bus:
        tip = Tip(bus)
        tip.wait_until_it_moves()
        assert session.ask("tc", "joystick", "halt").returncode == 0
        tip.way(0.5)
        restarted(session, "joystick", pids, signal.SIGKILL)
        # Long enough for self-test, calibration and a press.
        assert tip.way(5) < STILL_M
        assert session.ask("tc", "joystick", "start").returncode == 0
        tip.wait_until_it_moves()

        stopped = session.ask("stop")
        assert stopped.returncode == 0 and "emergency stop by" in stopped.stdout
        tip.way(0.5)
        assert tip.way(1) < STILL_M
        for name in ("robot", "joystick"):
            restarted(session, name, pids, signal.SIGKILL)
        assert tip.way(5) < STILL_M
        refused = session.ask("tc", "robot", "power_on")
        assert refused.returncode == 1 and "emergency stop" in refused.stdout + refused.stderr
        assert session.ask("stop", "--release").returncode == 0
        assert tip.way(2) < STILL_M
        assert session.ask("tc", "robot", "power_on").returncode == 0
        tip.wait_until_it_moves()
    code, report = session.interrupt()
    assert code == 0, (session.errors(), report["failures"])
    # The hand is simulated, and presses anew.
    assert report["safety"]["presses"] >= 1
    assert report["safety"]["hold"] == ""


def test_after_a_stall_of_an_end_the_robot_holds_until_a_new_press(start, monkeypatch):
    session = start("taskboard")
    pids = session.pids()
    with session.bus(monkeypatch) as bus:
        tip = Tip(bus)
        for name in ("joystick", "robot", "joystick"):
            tip.wait_until_it_moves()
            os.kill(pids[name], signal.SIGSTOP)
            time.sleep(1.5)
            os.kill(pids[name], signal.SIGCONT)
            tip.place()
            # The simulated hand lets go for half a second, before it presses anew.
            assert tip.way(0.3) < STILL_M, name
        tip.wait_until_it_moves()
    code, report = session.interrupt()
    assert code == 0, (session.errors(), report["failures"])
    assert report["safety"]["presses"] == 4
    # The joystick has calibrated itself once.
    joystick = report["joystick"]
    assert joystick["state"] == "application"
    log = [entry["state"] for entry in joystick["log"]]
    assert log == ["standby", "standby", "calibrated", "application"]
    assert joystick["temperature_c"] > 20
    assert {entry["restarts"] for entry in report["processes"].values()} == {0}
