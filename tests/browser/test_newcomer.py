"""A newcomer, who only reads what the pages say, does a task with a step of each kind."""

import re

import common
import pytest
from browser import eventually
from running_session import RunningSession
from selenium.common.exceptions import WebDriverException
from selenium.webdriver import ActionChains

#: Two pages take most of a small machine, so the cameras are small.
SETUP = """
cameras = ["stereo", "static", "head"]
uplink_video = {cap_kbps = 85, size = "320x240", fps = 15}
"""
#: Its steps have much time: on a full machine pages let go of the handle often.
TASK = """<Tasks>
  <Pull name="pullGently" force_n="3" hold_s="0.5" timeout_s="600"/>
  <Reach name="reachLed0" led="0" hold_s="2" timeout_s="600"/>
  <Pursue name="pursueShortly" path="eight" seconds="5" turn_s="10"/>
  <Operation name="execAll">
    <Operation ref="beginTelepresence"/>
    <Elemop ref="pullGently"/>
    <Elemop ref="highlightLed0"/>
    <Elemop ref="reachLed0"/>
    <Elemop ref="highlightSpot"/>
    <Elemop ref="pursueShortly"/>
    <Elemop ref="darkLeds"/>
    <Operation ref="endTelepresence"/>
  </Operation>
  <Operation name="execPull">
    <Operation ref="beginTelepresence"/>
    <Elemop ref="pullGently"/>
    <Operation ref="endTelepresence"/>
  </Operation>
  <Task name="all" start="startSpring" exec="execAll" start_x_mm="-100" start_y_mm="0"
        text="Pull the spring, move to the LED, and keep the tip on the moving spot."/>
  <Task name="pull" start="startSpring" exec="execPull" start_x_mm="-100" start_y_mm="0"
        text="Pull the spring."/>
</Tasks>"""
#: By their places in the list, after those of the catalogue.
TASK_NUMBERS = {"all": 8, "pull": 9}
#: One box on the page, as a person sees it.
BOX = """
    const titles = [...document.querySelectorAll("h2")];
    const found = titles.find((one) => one.innerText.toLowerCase() === arguments[0]);
    return found?.checkVisibility() ? found.closest(".panel") : null;
"""
WAY = re.compile(r"(\d+) mm (left|right|up|down)")
#: What leads a newcomer through a task, in its order.
LEADS = (
    "Then press the button",
    "Go ",
    "let go of the mouse button",
    "Press it now",
    "Do the task",
    "Next task",
)
SIGNS = {"left": (-1, 0), "right": (1, 0), "up": (0, -1), "down": (0, 1)}
EDGE = 20  #: So near the edge a hand lets the handle go, and takes it anew in the middle.


@pytest.fixture
def session(tmp_path):
    (tmp_path / "all.xml").write_text(TASK)
    options = ("--tasks", "all.xml", "--page", "24140", "--joystick", "page")
    with RunningSession(SETUP, *options, directory=tmp_path) as running:
        yield running
        report = running.finish()
        assert report["failures"] == []
        assert [run["result"] for run in report["tasks"]] == ["finished"]


class Newcomer:
    """Knows what a button and a mouse are, and nothing of this program."""

    def __init__(self, browser, address):
        self.page, self.driver = browser.open(address), browser.driver
        self.per_mm, self.at, self.holds, self.pulls = 1.0, (0, 0), False, 0
        #: What led it so far.
        self.led = set()

    def sit_down(self, words):
        """Take the seat that is for what one wants to do."""
        self.click("take a seat", words, "a")
        eventually(lambda: "Take a seat" not in self.page.driver().title, "the seat")

    def read(self, title=""):
        """Return the words of the page, or of the box with this title."""
        if not title:
            return self.page.run("return document.querySelector('main').innerText")
        box = self.page.run(BOX, title)
        return "" if box is None else box.text

    def click(self, title, words, kind="button", which=0):
        """Click what has these words; whether there was something to click."""
        driver = self.page.driver()
        root = self.page.run(BOX, title) or driver.find_element("css selector", "main")
        found = [one for one in root.find_elements("css selector", kind) if words in one.text]
        if len(found) <= which or not found[which].is_enabled():
            return False
        try:
            found[which].click()
        except WebDriverException:
            return False
        return True

    def press(self):
        picture = self.page.find("#picture")
        ActionChains(self.page.driver(), duration=50).click_and_hold(picture).perform()
        where = picture.rect
        middle = where["x"] + where["width"] / 2, where["y"] + where["height"] / 2
        self.at, self.holds = middle, True

    def release(self):
        ActionChains(self.page.driver(), duration=50).release().perform()
        self.holds = False

    def drag(self, words):
        """Drag the handle to where the page says; learn how far a millimetre is."""
        if not self.holds:
            self.press()
        mm = [0, 0]
        for far, way in WAY.findall(words):
            for axis in (0, 1):
                mm[axis] += int(far) * SIGNS[way][axis]
        across, down = (round(self.per_mm * one) for one in mm)
        width, height = self.page.run("return [innerWidth, innerHeight]")
        to = self.at[0] + across, self.at[1] + down
        if not (EDGE < to[0] < width - EDGE and EDGE < to[1] < height - EDGE):
            self.release()
            return mm
        ActionChains(self.page.driver(), duration=200).move_by_offset(across, down).perform()
        self.at = to
        self.wait(0.25)
        return mm

    def wait(self, seconds):
        self.page.run("return new Promise((done) => setTimeout(done, arguments[0]))", 1e3 * seconds)

    def watch(self, words):
        """Keep still for up to 2 s, until what to do is no longer this."""
        for _ in range(20):
            if words not in self.read("what to do"):
                break
            self.wait(0.1)

    def act(self):
        """Do what the page says now; return what it says."""
        says = self.read("what to do")
        self.led |= {words for words in LEADS if words in says}
        if "press the button" in says or "Next task" in says:
            self.click("what to do", "")
        elif "let go of the mouse button" in says:
            self.release()
        elif "Press it now" in says:
            self.release()
            self.press()
            self.watch("Press it now")
        elif "Go " in says:
            self.go(says)
        elif "Do the task" in says:
            self.do()
        return says

    def go(self, says):
        before = WAY.findall(says)
        gone = self.drag(says)
        after = WAY.findall(self.read("what to do"))
        if before and after and before[0][1] == after[0][1] and int(before[0][0]) > 20:
            share = 1 - int(after[0][0]) / int(before[0][0])
            if share > 0.05 and any(gone):
                self.per_mm = min(8.0, self.per_mm / share)

    def do(self):
        """In a run: words over the picture lead."""
        seen = self.read()
        if "press anew" in seen or "you steer" not in seen:
            self.release()
        if not self.holds:
            self.press()
        if WAY.search(seen):
            self.drag(" ".join(line for line in seen.split("\n") if WAY.search(line)))
        elif further := re.search("a little (?:further|to the) (left|right)", seen):
            self.pulls += 1
            if self.pulls == 8:
                # The spring takes the tip back, so it is no longer where the handle is.
                self.release()
                self.wait(0.5)
                self.press()
            self.drag(f"3 mm {further[1]}")
        else:
            self.wait(0.2)


@pytest.mark.parametrize(("words", "task"), [("do the tasks", "all"), ("steer the robot", "pull")])
def test_a_newcomer_finishes_a_task_by_what_the_pages_say(words, task, session, start_browser):
    browser = start_browser(size=(1280, 900))
    # The one address that is printed leads to every seat.
    address = session.pages()["pages"]
    panel, top = Newcomer(browser, address), Newcomer(browser, address)
    assert "select a task" in top.read() and "Alone?" in top.read()
    top.sit_down("select a task")
    panel.sit_down(words)
    eventually(lambda: "Wait for a task" in panel.act(), "a panel that waits")
    number = TASK_NUMBERS[task]
    eventually(lambda: top.click("experiment", "Select", which=number), "the selection")
    eventually(lambda: "Wait" not in panel.read("what to do"), "the task on the panel")
    try:
        common.eventually(lambda: "Finished" in panel.act(), "the end of the task", 300.0)
    finally:
        print(panel.read())
    eventually(lambda: "✓ finished" in top.read("runs"), "the run")
    assert task in top.read("runs")
    eventually(lambda: "●" in top.read("steps") and "○" not in top.read("steps"), "all dots")
    eventually(lambda: "Wait for a task" in panel.act(), "a panel that waits again")
    # A page that was busy has let go by itself.
    assert panel.led | {"let go of the mouse button"} == {*LEADS}
    browser.assert_no_errors()
