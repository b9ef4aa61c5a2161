"""SpaceJustin in MuJoCo, and a stranger's arm, in whole sessions by the documents' commands."""

import os
import shutil
import signal
from pathlib import Path

import pytest
from programs import running
from robot_tip import Tip
from running_session import BOARD, COMMAND, eventually

from pipelines.session.mission_messages import MISSION_GROUND_TOPIC, ROBOT_STATUS_TOPIC
from pipelines.session.topic_ends import TopicReader

pytest.importorskip("mujoco", reason="mujoco: pip install mujoco")

SAMPLES = Path(__file__).resolve().parents[2] / "samples"
LAB = """
cameras = ["head"]
uplink_video = {cap_kbps = 85, size = "160x120", fps = 5}
# An old picture holds no robot here: how busy the machine is is another test's.
safety = {picture_max_age_s = 100, picture_hold_s = 100}
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


def test_an_arm_is_driven_seen_and_outlives_its_physics(start, tmp_path, monkeypatch):
    shutil.copytree(SAMPLES / "mujoco_robot", tmp_path / "mujoco_robot")
    session = start(LAB, "--robot", "mujoco_robot:SpaceJustin", "--record", "run.mcap")
    session.wait_for_flow()
    with session.bus(monkeypatch) as bus:
        state = Tip(bus).state
        began_m = state().x_m
        eventually(lambda: abs(state().x_m - began_m) > 0.01, "a motion")
    killed = physics_of(session)
    os.kill(killed, signal.SIGKILL)
    eventually(lambda: physics_of(session) not in (None, killed), "the physics again")

    def powered():
        session.ask("tc", "robot", "reset_error")
        return session.ask("tc", "robot", "power_on").returncode == 0

    eventually(powered, "power after the error")
    physics = physics_of(session)
    report = session.finish()
    assert report["streams"]["uplink_video"]["frames_displayed"] > 0
    assert not any(one["restarts"] for one in report["processes"].values())
    eventually(lambda: not Path(f"/proc/{physics}").exists() or None, "the end of the physics")


def test_a_simulated_cosmonaut_pushes_the_partners_hand_and_gives_it_the_ball(
    start, tmp_path, monkeypatch
):
    shutil.copytree(SAMPLES / "mujoco_robot", tmp_path / "mujoco_robot")
    arms = ("--robot", "mujoco_robot:SpaceJustin", "--second-robot", "mujoco_robot:LeftArm")
    session = start('partner_arm = "second"' + LAB, "--tasks", *arms)
    session.wait_for_flow()
    drive = (*COMMAND, "joystick", "drive", "--base-port", str(session.base_port))
    partner = running(tmp_path / "partner.txt", *drive, end=signal.SIGKILL, env=session.environment)
    with partner, session.bus(monkeypatch) as bus:
        ground = TopicReader(bus, MISSION_GROUND_TOPIC)

        def finished(task):
            if (shown := ground.latest()) is None:
                return False
            done = any((run.task, run.result) == (task, "finished") for run in shown.runs)
            if not done and shown.phase == "idle":
                # A late machine may have ended the run before with a fault.
                session.ask("tc", "robot", "reset_error")
                session.ask("task", "select", task)
            return done

        for task in ("handshake", "ball"):
            eventually(lambda task=task: finished(task), f"the end of {task}", timeout_s=180)
        joints = TopicReader(bus, ROBOT_STATUS_TOPIC)
        assert len(eventually(joints.latest, "the robot's state").joints) == 7
    session.interrupt()


def test_a_strangers_arm_runs_a_session(start, tmp_path):
    pytest.importorskip(
        "gymnasium_robotics", reason="gymnasium-robotics: pip install gymnasium-robotics"
    )
    shutil.copy(SAMPLES / "strangers_arm.py", tmp_path)
    session = start(BOARD, "--robot", "strangers_arm:Fetch", "--record", "run.mcap")
    session.wait_for_flow(["haptic_up"])
    for order in ("power_off", "power_on"):
        eventually(lambda order=order: session.ask("tc", "robot", order).returncode == 0, order)
    report = session.finish()
    assert report["haptic"]["up"]["received"] > 0
    assert report["processes"]["robot"]["restarts"] == 0
