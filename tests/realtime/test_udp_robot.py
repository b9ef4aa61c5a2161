"""A robot and a joystick in C, by UDP: the sample is compiled, checked, and runs a session."""

import contextlib
import shutil
import signal
import subprocess
from collections import Counter
from pathlib import Path

import pytest
from common import free_port
from mcap.reader import make_reader
from robot_tip import Tip
from running_session import SEAT, eventually

from kontur_av.clock import MonotonicClock
from pipelines.hand.driver_checks import RobotCheck
from telepresence.haptics.specs import load_robot

SOURCE = Path(__file__).resolve().parents[2] / "samples" / "udp_robot.c"
#: An old picture holds no robot here: how busy the machine is is another test's.
SETUP = SEAT + "safety = {picture_max_age_s = 100, picture_hold_s = 100}\n"
FLAGS = ("-O2", "-std=c11", "-Wall", "-Wextra", "-Werror")


@pytest.fixture(scope="module")
def binary(tmp_path_factory):
    if shutil.which("cc") is None:
        pytest.skip("cc: apt-get install gcc")
    path = tmp_path_factory.mktemp("c") / "udp_robot"
    subprocess.run(["cc", *FLAGS, "-o", path, SOURCE], check=True)
    return path


@pytest.fixture
def controller(binary):
    """controller("robot", port, *key): a running one, which ends after the test in any case."""
    with contextlib.ExitStack() as stack:

        def start(*words):
            process = stack.enter_context(subprocess.Popen([binary, *map(str, words)]))
            stack.callback(process.kill)
            return process

        yield start


def power_on(session):
    return session.ask("tc", "robot", "power_on")


def test_the_robot_in_c_passes_its_check_with_a_key(controller, tmp_path):
    key, port = tmp_path / "arm.key", free_port()
    key.write_text("5a" * 32)
    key.chmod(0o600)
    controller("robot", port, key)
    device = load_robot(f"udp:127.0.0.1:{port}:{key}")
    results = list(RobotCheck(device, MonotonicClock()).run())
    assert device.capabilities.name == "a mass in C"
    # How long its calls take, and how old a reading is, is the machine's affair.
    failed = {
        figure.name for one in results for figure in one.metrics if one.trouble or not figure.passed
    }
    assert failed <= {"its calls, p99.9", "same in motion", "steps"}
    assert not [result.trouble for result in results if result.trouble]
    assert "silence" in [result.name for result in results]
    metrics = device.metrics()
    assert metrics.udp_sessions >= 1
    assert metrics.udp_foreign == metrics.udp_malformed == 0


def test_a_session_outlives_its_robots_controller(start, controller, tmp_path, monkeypatch):
    robot_port, joystick_port = free_port(), free_port()
    robot = controller("robot", robot_port)
    joystick = controller("joystick", joystick_port)
    session = start(
        *(SETUP, "--robot", f"udp:127.0.0.1:{robot_port}"),
        *("--joystick", f"udp:127.0.0.1:{joystick_port}", "--record", "run.mcap"),
    )
    with session.bus(monkeypatch) as bus:
        tip = Tip(bus)
        tip.wait_until_it_moves()
        eventually(lambda: tip.state().contact and tip.state().force_n > 1.0, "a contact")

        robot.kill()
        eventually(lambda: "did not answer" in power_on(session).stderr, "the robot is off")
        # Its hand is not heard either, so no press comes.
        joystick.send_signal(signal.SIGSTOP)
        controller("robot", robot_port)

        def is_on():
            reset = session.ask("tc", "robot", "reset_error")
            return reset.returncode == 0 == power_on(session).returncode

        eventually(is_on, "a reset and power")
        assert tip.holds(500)
        joystick.send_signal(signal.SIGCONT)
        tip.wait_until_it_moves()
    report = session.finish()
    assert "has no key" in session.errors()
    assert report["haptic"]["up"]["received"] > 0 and report["safety"]["presses"] >= 2
    robot, joystick = (report["processes"][name] for name in ("robot", "joystick"))
    assert robot["restarts"] == joystick["restarts"] == 0
    for counts in (robot["counts"], joystick["counts"]):
        assert counts["udp_sessions"] >= 2 and counts["udp_losses"] >= 1
        assert counts["udp_readings"] > 0
    with (tmp_path / "run.mcap").open("rb") as file:
        recorded = Counter(channel.topic for _, channel, _ in make_reader(file).iter_messages())
    assert recorded["/haptic/up/sent"] > 0 and recorded["/haptic/down/sent"] > 0
