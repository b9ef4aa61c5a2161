"""A person at two pages, panel and TOP-UI, does a task from its selection to its end."""

from math import dist

import pytest
from browser import LIVE, eventually
from running_session import RunningSession
from selenium.webdriver import ActionChains, Keys

from telepresence.haptics.board import LIGHTS_M
from telepresence.haptics.joystick import JoystickModel

#: The LEDs of `execAiming`, in the order in which they light up.
AIMED = (7, 0, 5, 0)
#: The map shows a little more than the workspace.
MARGIN = 1.12
#: So near a drag ends; an LED counts as reached within 5 mm.
NEAR_M = 0.002
MOST_DRAGS = 20


WIDGET = "document.querySelector('task-widget')"
#: Two pages take most of a small machine, so the cameras are small.
SETUP = """
cameras = ["stereo", "static", "head"]
uplink_video = {cap_kbps = 85, size = "320x240", fps = 15}
"""


@pytest.fixture
def session(tmp_path):
    (tmp_path / "board.toml").write_text(SETUP)
    options = ("--tasks", "--page", "24140", "--joystick", "page")
    with RunningSession(str(tmp_path / "board.toml"), *options, directory=tmp_path) as running:
        yield running
        code, report = running.interrupt()
        assert code == 0, running.errors()
        assert report["failures"] == []
        (run,) = report["tasks"]
        assert (run["name"], run["result"]) == ("aiming", "finished")


class Hand:
    """The mouse on the panel's map, where the handle is a place in metres."""

    def __init__(self, page):
        self.page, self.driver = page, page.browser.driver
        self.map = page.find(".workspace-map")
        size, model = self.map.size, JoystickModel()
        half_pixels = size["width"] / model.half_width_m, size["height"] / model.half_height_m
        self.scale = min(half_pixels) / (2 * MARGIN)

    def press(self):
        ActionChains(self.driver, duration=50).click_and_hold(self.map).perform()

    def release(self):
        ActionChains(self.driver, duration=50).release().perform()

    def place_m(self):
        # A page that was kept from its work knows no place for a moment.
        words = self.page.wait("document.querySelector('.workspace-map').dataset.placeMm")
        return tuple(float(word) / 1000 for word in words.split())

    def steers(self):
        return self.page.run("return document.querySelector('hand-panel').dataset.steers") == "true"

    def drag_to(self, place_m):
        """Drag the handle there, no faster than a hand does.

        A page that was kept from its work for 100 ms has let go: then press anew.
        """
        for _ in range(MOST_DRAGS):
            if dist(self.place_m(), place_m) <= NEAR_M:
                return
            if not self.steers():
                self.release()
                self.press()
            (x_m, y_m), (to_x_m, to_y_m) = self.place_m(), place_m
            across, down = round((to_x_m - x_m) * self.scale), round((y_m - to_y_m) * self.scale)
            ActionChains(self.driver, duration=400).move_by_offset(across, down).perform()
            self.page.run("return new Promise((done) => setTimeout(done, 300))")
        pytest.fail(f"the handle did not come to {place_m}")

    def hold_at(self, place_m, condition, what):
        """Hold the handle there until the condition is true, also after a page that let go."""

        def held():
            self.drag_to(place_m)
            return condition()

        eventually(held, what)


def mode(page):
    return page.run("return document.querySelector('panel-status').dataset.mode")


def done(top):
    """How many steps of the run are ticked off."""
    return top.run("return document.querySelectorAll('step-list [data-done]').length")


def test_a_task_from_its_selection_to_its_end(session, start_browser):
    browser = start_browser(size=(1280, 900))
    pages = session.pages()
    # The one address that is printed leads to every seat.
    panel = browser.open(pages["pages"])
    panel.wait("document.querySelectorAll('#seats a').length === 6")
    roles = "return [...document.querySelectorAll('#others [data-role]')].map(({ href }) => href)"
    assert panel.run(roles)[2].endswith(pages["top"].partition("token=")[2])
    panel.find("[data-page=panel]").click()
    top = browser.open(pages["top"])
    top.wait("document.body.dataset.link === 'connected'")
    top.wait("document.querySelector('experiment-panel').dataset.phase === 'idle'")
    top.run("document.querySelector('[data-task=aiming]').click()")

    panel.show()
    eventually(lambda: mode(panel) == "task_info", "the task on the panel")
    panel.wait(LIVE)
    ActionChains(browser.driver).send_keys(Keys.ENTER).perform()
    eventually(lambda: mode(panel) == "move_to_start", "the way to the start")
    hand = Hand(panel)
    hand.hold_at(LIGHTS_M[0], lambda: mode(panel) == "hold", "the handle at the start")
    hand.release()
    eventually(lambda: mode(panel) == "press_deadman", "three seconds there")
    hand.press()
    eventually(lambda: mode(panel) == "running", "the start")
    panel.wait(f"{WIDGET}.hidden === false && {WIDGET}.textContent.includes('1 of 4')")

    def aimed():
        for led in AIMED:
            hand.drag_to(LIGHTS_M[led])
            panel.run("return new Promise((done) => setTimeout(done, 1000))")
        return mode(panel) == "finished"

    eventually(aimed, "the end")
    hand.release()

    top.show()
    eventually(lambda: done(top) == 12, "all steps of Fig. 14")
    result = "document.querySelector('run-table [data-result]').dataset.result"
    assert top.wait(result) == "finished"
    assert "off on average" in top.find("run-table").text
    panel.show()
    ActionChains(browser.driver).send_keys(Keys.ENTER).perform()
    eventually(lambda: mode(panel) == "wait_task", "the next task")
    browser.assert_no_errors()
