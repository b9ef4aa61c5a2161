"""A seat in a headset that npm's `iwer` emulates: a grip leads the robot, and a button stops it."""

import time
from itertools import cycle

import pytest
from browser import LIVE, eventually
from positions import ROOT
from robot_tip import Tip
from running_session import SEAT, RunningSession

from pipelines.hand.hand_topics import JOYSTICK_STATE_TOPIC

IWER = ROOT / ".ci" / "web" / "node_modules" / "iwer" / "build" / "iwer.min.js"
#: A worn headset, and what its right controller does: `squeeze`, and 2 mm a frame to `right`.
WORN = """
window.device = new IWER.XRDevice(IWER.metaQuest3);
device.installRuntime({ forceInstall: true });
// This emulation takes the matrix of an offset, WebXR its transform; and it tracks nothing.
const spaces = XRReferenceSpace.prototype, offset = spaces.getOffsetReferenceSpace;
spaces.getOffsetReferenceSpace = function ({ matrix }) { return offset.call(this, matrix); };
Object.defineProperty(XRPose.prototype, "emulatedPosition", { get: () => false });
const hand = device.controllers.right;
const where = { right: 0 };
window.squeeze = (value) => hand.updateButtonValue("squeeze", value);
window.lead = (right) => { where.right = right; };
window.stop = (value) => hand.updateButtonValue("b-button", value);
setInterval(() => {
  const { x } = hand.position;
  hand.position.x = x + Math.max(-0.002, Math.min(0.002, where.right - x));
}, 14);
"""


@pytest.fixture
def session(tmp_path):
    if not IWER.exists():
        pytest.skip("iwer: npm --prefix .ci/web install")
    options = ("--page", "24100", "--joystick", "page")
    with RunningSession(SEAT, *options, directory=tmp_path) as running:
        yield running


def test_a_grip_leads_the_robot_and_a_button_stops_it(session, start_browser, monkeypatch):
    # The processor draws for the headset, too.
    browser = start_browser(flags=["enable-unsafe-swiftshader"])
    page = browser.open("about:blank")
    page.load(session.pages()["space"], IWER.read_text(encoding="utf-8") + WORN)
    page.wait("!document.querySelector('headset-seat').hidden", "a button")
    page.wait(LIVE)
    page.wait("document.querySelector('joystick-panel').textContent.includes('application')")
    page.find("headset-seat button").click()
    page.wait("document.querySelector('headset-seat').textContent.includes('Leave')")
    with session.bus(monkeypatch) as bus:
        tip, joystick = Tip(bus), bus.reader(JOYSTICK_STATE_TOPIC)

        def held():
            with eventually(joystick.latest, "the joystick's state") as lease:
                return JOYSTICK_STATE_TOPIC.unpack(lease.octets()).dead_man

        def pressed():
            """Press anew: a page that is busy for 100 ms lets go."""
            if not held():
                page.run("squeeze(0)")
                time.sleep(0.2)
                page.run("squeeze(1)")
                time.sleep(0.3)
            return held()

        ends = cycle((0.05, 0.0))

        def moved():
            from_m = tip.state().x_m
            pressed()
            page.run("lead(arguments[0])", next(ends))
            time.sleep(1)
            return abs(tip.state().x_m - from_m) > 0.01

        eventually(moved, "a motion of the tip")
        page.run("squeeze(0)")
        eventually(lambda: not held(), "the release")
        # A robot that is late is still on its way.
        tip.rests()
        page.run("lead(arguments[0])", next(ends))
        assert tip.holds(1000)
        # The headset's menu is before the picture.
        eventually(pressed, "a new press")
        page.run("device.updateVisibilityState('visible-blurred')")
        eventually(lambda: not held(), "a hand that has let go before a menu")
        page.run("device.updateVisibilityState('visible')")
        eventually(pressed, "a new press")
        page.run("stop(1)")
        stopped = "document.querySelector('stop-control').textContent.includes('Emergency stop')"
        page.wait(stopped)
        eventually(lambda: not held(), "a hand that has let go")
    page.run("document.querySelector('headset-seat button').click()")
    page.wait("!document.querySelector('headset-seat').textContent.includes('Leave')")
    page.run("document.querySelector('[data-stop=release]').click()")
    page.wait(f"!({stopped})")
    browser.assert_no_errors()
