"""The Russian experiment at the page K2CP: the partner's robot across the Internet, then ours."""

import re
import shutil
from pathlib import Path

import numpy as np
from browser import eventually
from janus_room import free_port
from programs import running
from robot_tip import STILL_M, Tip
from running_session import COMMAND, RunningSession

from pipelines.hand.haptic_trace import CONTACT, JOYSTICK_TRACE_TOPIC, rows_of

SAMPLE = Path(__file__).resolve().parents[2] / "samples" / "own_robot.py"
LAB = 'cameras = ["head"]\npartner_arm = "board"\n[uplink_video]\ncap_kbps = 85\n'
#: The partner's robot: a mass on a spring, so each motion of it is felt, wherever it begins.
ROBOT = """
from own_robot import Mass

class Sprung(Mass):
    def wall(self):
        return -200.0 * self.x

    def read(self):
        return super().read()._replace(contact=abs(self.wall()) > 0.5)
"""


def button(name):
    return f"(document.querySelector('[data-joystick={name}]') ?? {{disabled: null}})"


def told(name):
    return f"document.querySelector('[data-system=\"{name}\"] dd')?.textContent.toLowerCase()"


def press(page, name):
    # At once: a page that stalls takes its buttons away.
    page.wait(f"((one) => one.disabled === false && (one.click(), true))({button(name)})")


def felt_contact(bus):
    """Wait until the hand feels a contact of the robot that answers the joystick."""
    reader = bus.reader(JOYSTICK_TRACE_TOPIC)

    def felt():
        if (block := reader.latest_octets()) is None:
            return False
        rows = rows_of(block)
        touching = rows[rows["flags"] & CONTACT != 0]
        return len(touching) > 0 and np.hypot(touching["fx_n"], touching["fy_n"]).max() > 0.3

    eventually(felt, "a contact's force at the hand")


def test_the_cosmonaut_drives_the_partners_robot_then_ours(start_browser, tmp_path, monkeypatch):
    token, port = tmp_path / "token", free_port()
    token.write_text("word-of-the-partner")
    shutil.copy(SAMPLE, tmp_path)
    (tmp_path / "partner_robot.py").write_text(ROBOT)
    way = ("--rtc", str(port), "--rtc-hand-token-file", str(token))
    options = (*way, "--page", str(free_port()))
    browser = start_browser()
    with RunningSession(LAB, *options, directory=tmp_path) as session:
        session.pids()
        page = browser.open(session.pages()["k2cp"])
        supervisor = browser.open(session.pages()["k2sv"])
        with session.bus(monkeypatch) as bus:
            tip = Tip(bus)
            tip.wait_until_it_moves()
            page.wait(f"{told('joystick.application')} === 'german experiment'")
            press(page, "stop")
            page.wait(f"{button('start')}.disabled === false")
            assert page.run(f"return {button('start_russian')}.disabled")
            refused = session.ask("tc", "joystick", "start_russian")
            assert refused.returncode == 1
            assert "the partner's robot is not there" in refused.stderr

            words = ("--rtc", f"http://127.0.0.1:{port}", "--token-file", str(token))
            robot = (*COMMAND, "robot", "serve", "--robot", "partner_robot:Sprung")
            out, how = tmp_path / "partner.txt", {"cwd": tmp_path, "env": session.environment}
            with running(out, *robot, *words, **how) as partner:
                press(page, "start_russian")
                supervisor.wait(f"{told('joystick.application')} === 'russian experiment'")
                supervisor.wait(f"{told('robot.partner')}?.startsWith('driven')")
                supervisor.wait(f"{told('robot.mode')} === 'off'")
                assert tip.way(3) < STILL_M
                felt_contact(bus)
                assert tip.way(2) < STILL_M
                press(page, "stop")
                press(page, "start")
                page.wait(f"{told('joystick.application')} === 'german experiment'")
                supervisor.wait(f"{told('robot.partner')} === 'ready'")
                tip.wait_until_it_moves()
                felt_contact(bus)
        text = out.read_text()
        assert partner.returncode == 0, text
        far_mm, most_n = re.search(r"went (\d+) mm far, and felt up to ([\d.]+) N", text).groups()
        assert int(far_mm) > 0 and float(most_n) > 0
        browser.assert_no_errors()
        report = session.finish()
    assert report["failures"] == []
    assert report["arm"]["authority"] == "operator" and report["arm"]["turns"] == 3
