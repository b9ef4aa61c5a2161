"""The ring over an old picture: at the tip that the hand commands."""

from contextlib import ExitStack
from itertools import cycle
from math import dist, inf

import pytest
from browser import LIVE, eventually
from robot_tip import Tip
from running_session import SEAT, RunningSession
from selenium.webdriver import ActionChains

from pipelines.media.following import board_view

MAP = ".workspace-map"
#: Two places on the page are the same, or clearly not.
NEAR_PX, FAR_PX = 4, 12
#: A robot that moves less in 0.3 s is at rest; one that moved so far was led.
REST_M, MOVED_M = 2e-4, 5e-3
OVERLAY = """
    const overlay = document.querySelector("board-overlay");
    const [picture, canvas] = [document.querySelector("#picture"), overlay.querySelector("canvas")];
    const [tip, note] = [overlay.dataset.tip ?? "", overlay.querySelector(".tip-note")];
    const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
    return {
      tip: tip === "" ? null : tip.split(" ").map(Number),
      drawn: data.some((one) => one > 0),
      note: note.checkVisibility() ? note.innerText : "",
      size: [canvas.clientWidth, canvas.clientHeight],
      aspect: picture.width / picture.height,
    };
"""


class Seat:
    """The operator's page, the hand on its map, and the robot's tip."""

    def __init__(self, session, bus, page):
        self.page, self.setup, self.place = page, session.setup, Tip(bus).place
        page.wait(LIVE)
        page.wait("document.querySelector('joystick-panel').textContent.includes('application')")

    def overlay(self):
        return self.page.run(OVERLAY)

    def steers(self):
        return self.page.run("return document.querySelector('hand-panel').dataset.steers") == "true"

    def hand(self):
        return ActionChains(self.page.driver(), duration=50)

    def hold(self):
        """Press in the middle until it is pressed: a page that was busy has let go."""

        def held():
            if not self.steers():
                self.hand().release().click_and_hold(self.page.find(MAP)).perform()
                self.pause(200)
            return self.steers()

        eventually(held, "a hand that steers")

    def lead(self, x):
        """Press in the middle and drag until the robot has moved and rests."""
        start = self.place()

        def led():
            # A press may come before the robot follows anybody: it is then to be pressed anew.
            if not self.steers() or dist(self.place(), start) < MOVED_M:
                self.hand().release().perform()
                self.hold()
                self.hand().move_by_offset(x, 0).perform()
                self.pause(1000)
            before = self.place()
            self.pause(300)
            return dist(before, start) > MOVED_M and dist(self.place(), before) < REST_M

        eventually(led, "a motion of the robot")

    def pause(self, ms):
        self.page.run("return new Promise((done) => setTimeout(done, arguments[0]))", ms)

    def spot(self, place):
        """Return where a place on the board is over the picture, in pixels of the page."""
        overlay, stream = self.overlay(), self.setup.uplink_video
        x, y = board_view(self.setup, "static").pixel(*place)
        width, height = overlay["size"]
        wide = min(width, height * overlay["aspect"])
        high = wide / overlay["aspect"]
        left, top = (width - wide) / 2, (height - high) / 2
        return left + wide * x / stream.width, top + high * y / stream.height

    def ring_away(self):
        """Return how far the ring is from the robot's tip, in pixels; infinite without a ring."""
        ring = self.overlay()["tip"]
        return inf if ring is None else dist(ring, self.spot(self.place()))


@pytest.fixture
def sit(tmp_path, start_browser, monkeypatch):
    """sit(*options): the operator at the page of a new session."""
    with ExitStack() as stack:

        def start(*options):
            words = ("--page", "24180", "--joystick", "page", *options)
            session = stack.enter_context(RunningSession(SEAT, *words, directory=tmp_path))
            bus = stack.enter_context(session.bus(monkeypatch))
            page = start_browser(size=(1280, 900)).open(session.pages()["space"])
            return Seat(session, bus, page)

        yield start


def test_at_a_long_round_trip_the_ring_is_where_the_tip_will_be(sit):
    seat, sides = sit("--radio-delay-ms", "400", "--hand", "auto"), cycle((-30, 30))
    eventually(lambda: "behind your hand" in seat.overlay()["note"], "the words")
    # Nobody steers, so nothing is commanded.
    assert seat.overlay()["tip"] is None
    # The second press begins where the robot is, and not in the middle, where the hand is.
    for x in (-40, 30):
        seat.lead(x)

        def there():
            seat.hold()
            return seat.ring_away() < NEAR_PX and seat.overlay()["drawn"]

        eventually(there, "a ring at the robot's tip")
        seat.hand().release().perform()
        eventually(lambda: seat.overlay()["tip"] is None, "no ring without a press")

    def ahead():
        """Whether the ring moved before the robot did."""
        seat.hold()
        start = seat.place()
        seat.hand().move_by_offset(next(sides), 0).perform()
        ring, now = seat.overlay()["tip"], seat.place()
        return ring and dist(now, start) < REST_M and dist(ring, seat.spot(now)) > FAR_PX

    eventually(ahead, "a ring ahead of the robot")
    seat.page.run("document.querySelector('.tip-note button').click()")
    eventually(lambda: "is hidden" in seat.overlay()["note"], "the words")
    eventually(
        lambda: {seat.overlay()[one] or None for one in ("tip", "drawn")} == {None}, "no ring"
    )
    seat.page.find("body").send_keys("p")

    def shown():
        seat.hold()
        return seat.overlay()["tip"]

    eventually(shown, "the ring again")
