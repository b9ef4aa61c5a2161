"""A user's robot in a whole session, by the command that the documents give."""

import shutil
from pathlib import Path

from robot_tip import Tip
from running_session import BOARD, eventually

SAMPLE = Path(__file__).resolve().parents[2] / "samples" / "own_robot.py"


def test_the_samples_robot_is_moved_touches_its_wall_and_stops(start, tmp_path, monkeypatch):
    shutil.copy(SAMPLE, tmp_path)
    session = start(BOARD, "--robot", "own_robot:Mass", "--record", "run.mcap")
    session.wait_for_flow()
    with session.bus(monkeypatch) as bus:
        tip = Tip(bus)
        state = tip.state
        eventually(lambda: state().contact and state().force_n > 1.0, "a contact")
        assert session.ask("stop").returncode == 0
        eventually(lambda: session.ask("tc", "robot", "power_on").returncode == 1, "the stop")
        # The wall pushes it out, slowly, because it brakes.
        eventually(lambda: abs(state().force_n) < 0.5, "its way out")
        tip.rests()
        place = state()
        assert tip.holds(1000)
        session.ask("stop", "--release")
        eventually(lambda: session.ask("tc", "robot", "power_on").returncode == 0, "its power")
        eventually(lambda: abs(state().x_m - place.x_m) > 0.02, "a motion after a new press")
    report = session.finish()
    assert report["haptic"]["up"]["received"] > 0
    assert report["safety"]["stops"] == 1
    assert report["processes"]["robot"]["restarts"] == 0
