"""SpaceJustin in MuJoCo, and a stranger's arm, in whole sessions by the documents' commands."""

import os
import shutil
import signal
import subprocess
from pathlib import Path

import pytest
from running_session import COMMAND, eventually

from pipelines.session.mission_messages import ExperimentShown, RobotStatus, unpack
from pipelines.session.topology import MISSION_GROUND_TOPIC, ROBOT_STATUS_TOPIC

pytest.importorskip("mujoco")

SAMPLES = Path(__file__).resolve().parents[2] / "samples"
LAB = """
cameras = ["head"]
partner_arm = "second"
uplink_video = {cap_kbps = 85, size = "320x240", fps = 10}
"""
PLAN = 'skill = 1.0\n[[task]]\nname = "handshake"\n'
#: The joystick of a partner who presses the button, pushes to the right for a while, and lets go.
HAND = """
from telepresence.haptics.device.device import JoystickFacts, JoystickReading
from telepresence.haptics.device.states import JoystickState


class Push:
    facts = JoystickFacts(name="push", half_width_m=0.1, half_height_m=0.08)
    application, time_s = False, 0.0

    def read(self):
        now_s = self.time_s % 8.0
        out, back = now_s - 1.0, 7.5 - now_s
        x_m = 0.06 * max(0.0, min(1.0, out, back))
        vx_m_s = 0.06 * (0.0 < out < 1.0) - 0.06 * (0.0 < back < 1.0)
        return JoystickReading(x_m, 0.0, vx_m_s, 0.0, dead_man=now_s > 0.5)

    def show_state(self, state):
        self.application = state is JoystickState.APPLICATION

    def advance(self, dt_ns):
        self.time_s += dt_ns / 1e9 if self.application else 0.0

    def set_zero(self, x_m, y_m): ...
    def write_force(self, x_n, y_n): ...
    def write_leds(self, mask): ...
    def close(self): ...
"""


def physics_of(session):
    """The pid of the process that has the physics of both arms."""
    for entry in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            words = entry.read_text()
        except OSError:
            continue
        if "mujoco_robot.physics" in words and str(session.temporary) in words:
            return int(entry.parent.name)
    return None


def test_both_hands_shake_and_the_physics_comes_back(start, tmp_path, monkeypatch):
    shutil.copytree(SAMPLES / "mujoco_robot", tmp_path / "mujoco_robot")
    (tmp_path / "hand.py").write_text(HAND)
    (tmp_path / "plan.toml").write_text(PLAN)
    lab = tmp_path / "lab.toml"
    lab.write_text(LAB)
    arms = ("--robot", "mujoco_robot:SpaceJustin", "--second-robot", "mujoco_robot:LeftArm")
    session = start(str(lab), *arms, "--plan", "plan.toml", "--record", "run.mcap")
    session.wait_for_flow(["haptic_up"])
    words = ["joystick", "drive", "--device", "hand:Push", "--base-port", str(session.base_port)]
    partner = subprocess.Popen([*COMMAND, *words], cwd=tmp_path, env=session.environment)
    try:
        with session.bus(monkeypatch) as bus:
            readers = {
                RobotStatus: bus.reader(ROBOT_STATUS_TOPIC),
                ExperimentShown: bus.reader(MISSION_GROUND_TOPIC),
            }

            def newest(kind):
                with eventually(readers[kind].latest, kind.__name__) as lease:
                    return unpack(kind, lease.octets())

            eventually(lambda: newest(ExperimentShown).runs, "the end of the task", 120.0)
            killed = physics_of(session)
            os.kill(killed, signal.SIGKILL)
            eventually(lambda: physics_of(session) not in (None, killed), "the physics again")
            # It was off after its task; a robot whose physics is missing says so.
            session.ask("tc", "robot", "reset_error")
            eventually(lambda: session.ask("tc", "robot", "power_on").returncode == 0, "power")
            eventually(lambda: newest(RobotStatus).powered, "a robot that is on")
    finally:
        partner.send_signal(signal.SIGINT)
        partner.wait()
    physics = physics_of(session)
    code, report = session.interrupt()
    assert code == 0, (session.errors(), report["failures"])
    (run,) = report["tasks"]
    assert (run["name"], run["result"]) == ("handshake", "finished"), run
    assert run["force_max_n"] >= 1.0
    assert run["other_force_max_n"] >= 1.0
    assert report["second_arm"]["received"] > 0
    assert report["streams"]["uplink_video"]["displayed"] > 0
    assert not any(one["restarts"] for one in report["processes"].values())
    eventually(lambda: not Path(f"/proc/{physics}").exists() or None, "the end of the physics")


def test_a_strangers_arm_runs_a_session(start, tmp_path):
    pytest.importorskip("gymnasium_robotics")
    shutil.copy(SAMPLES / "strangers_arm.py", tmp_path)
    session = start("taskboard", "--robot", "strangers_arm:Fetch", "--record", "run.mcap")
    session.wait_for_flow(["haptic_up"])
    assert session.ask("tc", "robot", "power_off").returncode == 0
    assert session.ask("tc", "robot", "power_on").returncode == 0
    code, report = session.interrupt()
    assert code == 0, (session.errors(), report["failures"])
    assert report["haptic"]["up"]["received"] > 0
    assert report["processes"]["robot"]["restarts"] == 0
