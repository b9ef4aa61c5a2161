"""A hand with a third axis and a gripper: a slider each at the page, moved by holding it."""

import pytest
from browser import eventually
from mcap.reader import make_reader
from running_session import SEAT, RunningSession
from selenium.webdriver import ActionChains

from pipelines.hand.hand_topics import JOYSTICK_STATE_TOPIC
from pipelines.hand.haptic_trace import ROBOT_TRACE_TOPIC, rows_of
from pipelines.recording.recorded_messages import unpack_haptics

SETUP = SEAT + 'axes = ["x", "y", "z", "gripper"]\nuplink = {frame_octets = 48}\n'
SLIDERS = "document.querySelectorAll('axis-sliders input')"


@pytest.fixture
def session(tmp_path):
    options = ("--page", "24100", "--joystick", "page", "--record", "run.mcap")
    with RunningSession(SETUP, *options, directory=tmp_path) as running:
        yield running


def newest(reader, read):
    lease = eventually(reader.latest, "a sample of a topic")
    with lease:
        return read(lease.octets())


def test_sliders_move_the_axes_and_all_of_it_is_recorded(
    session, start_browser, tmp_path, monkeypatch
):
    page = start_browser(size=(1280, 900), scale=1).open(session.pages()["space"])
    page.wait(f"{SLIDERS}.length === 2", "a slider for z, and one for the gripper")
    page.wait("document.querySelector('joystick-panel').textContent.includes('application')")
    with session.bus(monkeypatch) as bus:
        trace, joystick = bus.reader(ROBOT_TRACE_TOPIC), bus.reader(JOYSTICK_STATE_TOPIC)

        def held():
            return newest(joystick, JOYSTICK_STATE_TOPIC.unpack).dead_man

        for axis, field in enumerate(("z_m", "gripper_m")):

            def moved(axis=axis, field=field):
                """Hold the slider, and pull it to the right until the robot's axis is there."""
                slider = page.driver().find_elements("css selector", "axis-sliders input")[axis]
                act = ActionChains(page.browser.driver, duration=50)
                act.release().click_and_hold(slider).move_by_offset(60, 0).pause(0.5).perform()
                return newest(trace, rows_of)[field][-1] > 0.01

            eventually(moved, f"a motion of {field}")
            ActionChains(page.browser.driver).release().perform()
            eventually(lambda: not held(), "the release")
    # On a telephone nothing is cut off, and a finger can lead a slider.
    page.fit(390)
    page.wait("innerWidth === 390 && document.documentElement.scrollWidth <= 390")
    assert page.run(f"return Math.min(...[...{SLIDERS}].map((one) => one.offsetWidth))") > 120
    page.screenshot(tmp_path / "axes.png")
    page.browser.assert_no_errors()
    report = session.finish()
    assert set(report["haptic"]["down"]["axes"]) == {"z", "gripper"}
    assert report["haptic"]["down"]["cap_bps"] == 8000 * 22
    with (tmp_path / "run.mcap").open("rb") as file:
        recorded = [
            unpack_haptics(message.data)
            for _, channel, message in make_reader(file).iter_messages()
            if channel.topic == "/haptic/up/sent"
        ]
    assert max(rows["z_m"].max() for rows in recorded) > 0.01
