"""Both seats of one live session: seen, switched, joined, steered, heard, and left alone.

Session and browser are started once. Each test opens only the pages that it looks at, because a
page takes nearly half a core where no graphics card helps.
"""

import time
from itertools import cycle

import browser as browsers
import numpy as np
import pytest
from browser import LIVE, drawn, eventually, luma, psnr_db, wait_for_pictures
from common import write_tone
from numbered_pictures import (
    NumberedPictures,
    number_of,
    number_on,
    numbered_picture,
    write_pictures,
)
from robot_tip import Tip
from running_session import RunningSession, restarted
from selenium.webdriver import ActionChains, Keys

from pipelines.hand.hand_topics import JOYSTICK_STATE_TOPIC
from pipelines.session.mission_messages import ROBOT_STATUS_TOPIC
from pipelines.session.topic_ends import TopicReader
from telepresence.haptics.envelope import Hold

#: A fine picture; less than a picture that began wrongly lacks to it.
FINE_DB, LOSS_DB = 35.0, 8.0
#: A tone that noise suppression does not take for noise: half a second of it in every second.
TONE_HZ = 600
#: A level between silence and a voice, on the pages' meters.
HEARD_DB = -45


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    with NumberedPictures(tmp_path_factory.mktemp("fifo") / "static.y4m") as written:
        yield written


@pytest.fixture(scope="module")
def session(pictures, tmp_path_factory):
    if (lacking := browsers.missing()) is not None:
        pytest.skip(lacking)
    directory = tmp_path_factory.mktemp("session")
    with RunningSession(
        "spacejustin",
        *("--page", "24100", "--joystick", "page"),
        *("--source", f"static=pipe:{pictures.path}", "--source", "ground_mic=page"),
        directory=directory,
    ) as running:
        running.pids()
        yield running
        report = running.finish(silent=True)
        assert report["failures"] == []
        assert restarted(report) == {}


@pytest.fixture(scope="module")
def browser(session, tmp_path_factory):
    directory = tmp_path_factory.mktemp("devices")
    camera, microphone = directory / "camera.y4m", directory / "microphone.wav"
    write_pictures(camera, 60)
    write_tone(microphone, TONE_HZ, pauses=True)
    with browsers.Browser(camera=camera, microphone=microphone) as running:
        yield running


@pytest.fixture(scope="module")
def another(session):
    """A browser of another person, in which errors may come."""
    with browsers.Browser() as running:
        yield running


@pytest.fixture
def space(session, browser):
    page = browser.open(session.pages()["space"])
    yield page
    page.close()


@pytest.fixture
def ground(session, browser):
    page = browser.open(session.pages()["ground"])
    yield page
    page.close()


@pytest.fixture(autouse=True)
def no_errors(browser):
    yield
    browser.assert_no_errors()


def wait_for_number(page, more_than, selector="#picture"):
    """Wait until a page shows a picture with a larger number; return it."""

    def newer():
        number = number_on(page, selector)
        return number if number is not None and number > more_than else None

    return eventually(newer, f"a picture after number {more_than}")


def filmed(page):
    """Return (number, luma) of a picture that `page` shows, if its number can be read."""
    pixels = page.pixels()
    number = number_of(pixels)
    return None if number is None else (number, luma(pixels))


def likeness_db(page):
    """Return how like a picture that `page` shows is to what was filmed; None in doubt."""
    if (found := filmed(page)) is None:
        return None
    number, shown = found
    return psnr_db(shown, numbered_picture(number)[: shown.shape[0]])


def select(page, camera):
    """Select a camera by click; wait until its selection is acknowledged."""
    button = f"document.querySelector('button[data-camera={camera}]')"

    def acknowledged():
        if page.run(
            f"return {button}.ariaCurrent === 'true'"
            f" && document.querySelector('camera-buttons').textContent.includes('{camera}: ack')"
        ):
            return True
        # A click on a page that stalled is lost. One that was taken is pending until its answer.
        if page.run(f"return !{button}.disabled && {button}.dataset.pending !== 'true'"):
            page.find(f"button[data-camera={camera}]").click()
        return False

    eventually(acknowledged, f"the acknowledgement of {camera}")


def test_both_seats_show_the_session(space, ground):
    for page in (space, ground):
        page.wait(LIVE)
        page.wait("document.body.dataset.link === 'connected'")
        wait_for_pictures(page)
        # Nothing comes from anywhere else.
        assert page.run(
            "return performance.getEntriesByType('resource')"
            ".every((entry) => entry.name.startsWith(location.origin))"
        )
    ground.wait("document.querySelector('#sent').dataset.stale === 'false'")
    eventually(lambda: isinstance(space.figure("uplink_video.age_ms"), float | int), "the age")
    eventually(lambda: isinstance(ground.figure("downlink_video.age_ms"), float | int), "the age")
    state = "gateways.space.supervision.state"
    eventually(lambda: space.figure(state) == "connected", "contact")


def test_a_click_selects_a_camera_whose_pictures_come_one_after_the_other(space, pictures):
    space.wait(LIVE)
    select(space, "static")
    numbers = [wait_for_number(space, 0)]
    while len(numbers) < 8:
        numbers.append(wait_for_number(space, numbers[-1]))
        assert numbers[-1] <= pictures.newest + 1


@pytest.fixture
def numbered(space):
    """The operator's seat while it shows numbered pictures."""
    space.wait(LIVE)
    select(space, "static")
    wait_for_number(space, 0)
    return space


def test_a_stream_that_changes_its_size_goes_on(numbered, ground, pictures):
    def small():
        # Cuts that follow each other make the encoder choose the smaller size.
        pictures.bright = not pictures.bright
        wait_for_pictures(numbered, 10)
        return numbered.run("return document.querySelector('#picture').width") == 256

    eventually(small, "pictures of 256x192")
    for page, selector in ((numbered, "#picture"), (ground, "#sent")):
        first = wait_for_number(page, 0, selector)
        assert wait_for_number(page, first, selector) <= pictures.newest + 1


class Robot:
    """The robot and the joystick of the session, by their topics."""

    def __init__(self, bus):
        self._tip = Tip(bus)
        self._joystick = bus.reader(JOYSTICK_STATE_TOPIC)
        self._status = TopicReader(bus, ROBOT_STATUS_TOPIC)
        self._held = False

    def hold(self):
        status = self._status.latest() or self._status.newest
        return "" if status is None else status.hold

    def x_m(self):
        """Return the newest place of the tip."""
        return self._tip.state().x_m

    def held(self):
        """Return whether the joystick's dead-man button is pressed."""
        if (octets := self._joystick.latest_octets()) is not None:
            self._held = JOYSTICK_STATE_TOPIC.unpack(octets).dead_man
        return self._held


@pytest.fixture
def robot(session, monkeypatch):
    with session.bus(monkeypatch) as bus:
        yield Robot(bus)


MAP = ".workspace-map"


def press_with_pointer(page):
    act = ActionChains(page.browser.driver, duration=20)
    act.release().click_and_hold(page.find(MAP)).perform()


def press(page, robot, press_anew=press_with_pointer):
    """Press on the map of the workspace until the joystick is held."""

    def pressed():
        # A page that could not answer for 100 ms has let go and wants to be pressed anew.
        press_anew(page)
        for _ in range(20):
            if robot.held():
                return True
            time.sleep(0.05)
        return False

    page.wait("document.querySelector('joystick-panel').textContent.includes('application')")
    eventually(pressed, "a held joystick")


def drag(page, x, y):
    ActionChains(page.browser.driver, duration=50).move_by_offset(x, y).perform()


def release(page):
    ActionChains(page.browser.driver).release().perform()


def test_a_pointer_moves_the_robot_and_its_release_stops_it(space, robot):
    def moved(from_m, pixels):
        if not robot.held():
            press(space, robot)
        drag(space, pixels, 0)
        return abs(robot.x_m() - from_m) > 0.01

    press(space, robot)
    start_m = robot.x_m()
    eventually(lambda: moved(start_m, -20), "a movement of the robot")
    assert robot.x_m() < start_m
    release(space)
    eventually(lambda: not robot.held(), "the release")
    space.wait("!document.querySelector('hand-tile').textContent.includes('YOU STEER')")

    def rests():
        position_m = robot.x_m()
        time.sleep(0.3)
        return abs(robot.x_m() - position_m) < 0.0005

    eventually(rests, "a robot at rest")
    # A pointer that is not pressed moves nothing.
    rest_m = robot.x_m()
    drag(space, 40, 0)
    time.sleep(0.3)
    assert abs(robot.x_m() - rest_m) < 0.002


def test_a_drag_after_a_key_chooses_a_focus_and_moves_no_robot(space, robot):
    part, act = "document.querySelector('.focus-part')", ActionChains(space.browser.driver)
    space.wait(LIVE)
    act.send_keys("f").click_and_hold(space.find("#picture")).move_by_offset(60, 40).perform()
    assert not robot.held()
    release(space)
    space.wait(f"!{part}.hidden && {part}.dataset.pending === 'false'")
    ActionChains(space.browser.driver).send_keys(Keys.DELETE).perform()
    space.wait(f"{part}.hidden")


def touch(page, kind, x=0):
    """A finger on the map, x pixels from its middle. kind: of the DevTools Protocol."""
    place = page.run(
        "const on = document.querySelector(arguments[0]).getBoundingClientRect();"
        "return {x: on.x + on.width / 2 + arguments[1], y: on.y + on.height / 2};",
        MAP,
        x,
    )
    points = [] if kind == "touchEnd" else [place]
    event = {"type": kind, "touchPoints": points}
    page.driver().execute_cdp_cmd("Input.dispatchTouchEvent", event)


def press_with_finger(page):
    touch(page, "touchEnd")
    touch(page, "touchStart")


#: At a short round trip no ring is over the picture, and no word about one.
NO_RING = (
    "!document.querySelector('board-overlay').dataset.tip"
    " && document.querySelector('.tip-note').hidden"
)


def test_a_finger_moves_the_robot_without_a_ring_and_lets_go_when_it_is_lifted(numbered, robot):
    space = numbered
    # To and fro, or a repetition would begin where the last one led to.
    sides = cycle((-1, 1))

    def moved():
        press_with_finger(space)
        if not robot.held():
            return False
        side, from_m = next(sides), robot.x_m()
        for step in range(1, 9):
            touch(space, "touchMove", 5 * side * step)
        time.sleep(0.3)
        return robot.held() and side * (robot.x_m() - from_m) > 0.01

    # Only a finger that is down can be lifted.
    touch(space, "touchStart")
    press(space, robot, press_with_finger)
    eventually(moved, "a movement of the robot")
    space.wait(NO_RING, "a picture without a ring")
    touch(space, "touchEnd")
    eventually(lambda: not robot.held(), "the release")


@pytest.mark.rule("S5")
def test_a_page_that_paints_no_picture_holds_the_robot(space, robot):
    wait_for_pictures(space)
    press(space, robot)
    # It still gets, decodes and draws them. A busy page lets go, and is pressed anew.
    space.run("window.requestAnimationFrame = () => 0")
    eventually(
        lambda: (robot.held() or press(space, robot)) and robot.hold() == Hold.PICTURE, "the hold"
    )
    release(space)


#: Notes whether the page steers when it is hidden.
NOTE_HIDDEN = """
document.addEventListener("visibilitychange", () => {
  if (document.hidden) steers.push(document.querySelector("hand-panel").dataset.steers === "true");
});
"""
#: Before the page's own listeners. Keeps the loss of the focus from them.
NOTE_FIRST = f"""
addEventListener("blur", (event) => event.stopImmediatePropagation());
window.steers = [];
{NOTE_HIDDEN}
"""


def test_a_tab_that_is_hidden_lets_go(space, browser, robot):
    space.reload(NOTE_FIRST)
    space.run(NOTE_HIDDEN)
    tab = browser.open("about:blank", "tab")

    def hide():
        """Return whether the page steered when it was hidden, and whether it still did after."""
        space.run("steers.length = 0")
        press(space, robot)
        tab.show()
        eventually(lambda: not robot.held(), "the release")
        space.wait("!document.hidden")
        noted = space.run("return steers")
        # A busy page may have let go before.
        return noted if noted[:1] == [True] else None

    assert eventually(hide, "a page that steers until it is hidden") == [True, False]
    time.sleep(0.3)
    assert not robot.held()
    release(space)
    tab.close()


def test_only_one_page_has_the_handle(space, browser, session, robot):
    def button(words):
        return (
            "[...document.querySelectorAll('hand-panel button')]"
            f".find((one) => !one.hidden && one.textContent.startsWith('{words}'))"
        )

    def click(page, words):
        # At once: a page that stalls takes its buttons away.
        done = f"((one) => one && !one.disabled && (one.click(), true))({button(words)})"
        page.wait(done, f"the button {words}")

    # A press takes the handle, and a release keeps it.
    press(space, robot)
    release(space)
    space.wait(f"{button('Give')} !== undefined")
    other = browser.open(session.pages()["space"])
    other.wait(f"{button('Ask')} !== undefined && {button('Take')} === undefined")
    ActionChains(browser.driver, duration=20).click_and_hold(other.find(MAP)).perform()
    other.wait("document.querySelector('hand-panel').textContent.includes('has the handle')")
    time.sleep(0.3)
    assert not robot.held()
    release(other)
    click(other, "Ask")
    space.wait("document.querySelector('hand-panel').textContent.includes('asks for it')")
    click(space, "Give")
    other.wait(f"{button('Give')} !== undefined")
    space.wait(f"{button('Ask')} !== undefined")
    press(other, robot)
    # The handle of a page that is gone is free, and nobody holds it.
    other.close()
    eventually(lambda: not robot.held(), "the release")
    click(space, "Take")
    space.wait(f"{button('Give')} !== undefined")
    click(space, "Give")


def level_db(page):
    meter = page.find("loudspeaker-panel level-meter")
    return float(meter.get_attribute("aria-valuenow"))


def toggle(page, panel):
    page.run(f"document.querySelector('{panel} button').click()")


def test_a_camera_arrives_at_the_other_page(space, ground, browser, session):
    space.wait("document.querySelector('camera-panel button').disabled === false")
    ground.wait(LIVE)
    assert number_on(ground) is None
    toggle(space, "camera-panel")
    wait_for_number(ground, 0)

    # A page that joins now begins at a local IDR picture. A wrong one stays for a wave. Where the
    # camera's page stalls, the stream is cut, and coarse for both.
    late = browser.open(session.pages()["ground"])

    def loss_db():
        shown, like = likeness_db(late), likeness_db(ground)
        return None if shown is None or like is None else min(like, FINE_DB) - shown

    losses_db = [eventually(loss_db, "a numbered picture on both") for _ in range(5)]
    print("a page that joined by a local IDR shows, less than the other,", losses_db, "dB")
    assert np.median(losses_db) < LOSS_DB
    late.close()
    toggle(space, "camera-panel")
    eventually(lambda: number_on(ground) is None, "the built-in camera")


def test_a_microphone_arrives_at_the_other_page(space, ground):
    ground.wait("document.querySelector('microphone-panel button').disabled === false")
    space.wait(LIVE)
    eventually(lambda: level_db(space) < HEARD_DB, "silence at first")
    toggle(ground, "microphone-panel")
    eventually(lambda: level_db(space) > HEARD_DB, "the tone")
    toggle(ground, "microphone-panel")
    eventually(lambda: level_db(space) < HEARD_DB, "silence")


def test_a_machine_without_sound_and_camera_says_so_and_shows_the_pictures(start_browser, session):
    bare = start_browser(devices=False)
    page = bare.open(session.pages()["ground"])
    page.wait(LIVE)
    toggle(page, "microphone-panel")
    page.wait("document.querySelector('microphone-panel').textContent.includes('no microphone')")
    page.wait("document.querySelector('loudspeaker-panel header span').textContent")
    wait_for_pictures(page)
    bare.assert_no_errors()


def test_a_page_that_stalls_disturbs_no_other(another, space, session):
    page = another.open(session.pages()["space"])
    page.wait(LIVE)
    before = drawn(page)
    with another.stalled():
        until_s = time.monotonic() + 3
        while time.monotonic() < until_s:
            wait_for_pictures(space)
    eventually(lambda: drawn(page) > before, "new pictures")
    page.wait(LIVE)
    page.wait("document.body.dataset.link === 'connected'")
    # Chromium says so if it closed a connection in its sleep.
    another.assert_no_errors(server_gone=True)
    page.close()
