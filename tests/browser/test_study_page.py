"""The page of a study, by mouse on a desk's screen and by finger on a telephone's."""

import contextlib
import json
import re
import time

from browser import TIMEOUT_S, eventually
from programs import running
from running_session import COMMAND

PLAN = """
name = "handle"
consent = "I take part of my own will."
participants = 2
practice = 0
trials = 1
break_s = 0
break_every = 1
note = "sitting"
[handle]
damping_n_s_m = [0, 10]
inertia_kg = [0.5]
[[aiming]]
name = "still"
width_m = 0.04
targets = 5
hold_s = 0.1
"""
#: Keeps the newest frame that the server sent, as a person sees it.
WATCH = """
    const Plain = WebSocket;
    window.WebSocket = class extends Plain {
      set onmessage(take) {
        super.onmessage = (event) => {
          const text = JSON.parse(event.data);
          if (text.kind === "frame") window.frame = text;
          else if (!["start", "trial"].includes(text.phase)) window.frame = null;
          take(event);
        };
      }
    };
"""
LOOK = """
    if (!window.frame) return null;
    const canvas = document.querySelector("#field canvas");
    const { left, top, width, height } = canvas.getBoundingClientRect();
    const scale = Math.min(width / 0.15, height / 0.10) / 2.08;
    const at = (x, y) => [left + width / 2 + x * scale, top + height / 2 - y * scale];
    const { x_m, y_m, target_x_m, target_y_m } = window.frame;
    return [...at(x_m, y_m), ...at(target_x_m, target_y_m)];
"""


@contextlib.contextmanager
def study(folder):
    """The address of the page that the command serves. Every exit ends it."""
    out = folder / "study.txt"
    with running(out, *COMMAND, "study", folder / "plan.toml", "--page", 28270) as process:
        yield eventually(lambda: re.match(r"(http\S+)\n", out.read_text()), "the address")[1]
    assert process.returncode == 0


def open_page(browser, url, *, width, touch):
    page = browser.open("about:blank")
    page.fit(width, height=800, mobile=touch)
    page.driver().execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": touch})
    page.load(url, WATCH)
    page.wait("document.body.dataset.phase")
    return page


def press(page, label):
    page.wait(f"document.querySelector('#go').textContent === {json.dumps(label)}")
    page.find("#go").click()


def point(page, kind, x, y, *, touch):
    """kind: Pressed, Moved or Released for a mouse; Start, Move or End for a finger."""
    if touch:
        points = [] if kind == "End" else [{"x": x, "y": y}]
        told = {"type": f"touch{kind}", "touchPoints": points}
        page.driver().execute_cdp_cmd("Input.dispatchTouchEvent", told)
    else:
        told = {"type": f"mouse{kind}", "x": x, "y": y, "button": "left", "clickCount": 1}
        told["buttons"] = 0 if kind == "Released" else 1
        page.driver().execute_cdp_cmd("Input.dispatchMouseEvent", told)


def do_trial(page, *, touch, picture=None):
    """Take the dot, and drag it to whatever the page shows, until the trial is over."""
    down, move, up = ("Start", "Move", "End") if touch else ("Pressed", "Moved", "Released")
    x, y, *_ = eventually(lambda: page.run(LOOK), "the field")
    point(page, down, x, y, touch=touch)
    began = pressed = time.monotonic()
    while (seen := page.run(LOOK)) is not None:
        now = time.monotonic()
        assert now - began < TIMEOUT_S, "the trial does not end"
        if now - pressed > 2 and page.run("return window.frame?.starting && !window.frame.rest"):
            # On a busy machine the page was silent for too long: press anew, as a person would.
            point(page, up, x, y, touch=touch)
            point(page, down, *seen[:2], touch=touch)
            pressed = now
        x, y = seen[2:]
        point(page, move, x, y, touch=touch)
        if picture and page.run("return document.body.dataset.phase") == "trial":
            page.screenshot(picture)
            picture = None
    point(page, up, x, y, touch=touch)


def trials(folder):
    lines = (folder / "plan.results" / "trials.jsonl").read_text().splitlines()
    return [json.loads(line) for line in lines[1:]]


def test_a_study_goes_by_mouse_and_after_an_interruption_on_by_finger(tmp_path, start_browser):
    (tmp_path / "plan.toml").write_text(PLAN)
    browser = start_browser(scale=1)
    with study(tmp_path) as url:
        page = open_page(browser, url, width=1280, touch=False)
        press(page, "I agree: begin")
        press(page, "Begin")
        do_trial(page, touch=False)
        page.wait("document.body.dataset.phase === 'break'")
        (first,) = trials(tmp_path)
        page.close()
    with study(tmp_path) as url:
        page = open_page(browser, url, width=390, touch=True)
        press(page, "Go on")
        press(page, "Begin")
        do_trial(page, touch=True)
        page.wait("document.body.dataset.phase === 'done'")
        assert page.find("#go").text == "Next person"
        both = trials(tmp_path)
    assert both[0] == first
    assert [one["participant"] for one in both] == [1, 1]
    assert {one["damping_n_s_m"] for one in both} == {0.0, 10.0}
    assert all(one["path_m"] > 0.4 and one["missed"] == 0 for one in both)
    assert all(one["note"] == "sitting" for one in both)
    browser.assert_no_errors(server_gone=True)
