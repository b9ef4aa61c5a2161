"""Take the pictures of the pages that the documents show.

    python docs/screenshots.py [space] [ground] [mission]

For each seat a session with the ISS overhead runs in real time, with the page in Chromium. In space
a hand at the page presses against the wall of the task board; for the ground it is the simulated
one. For the mission's pages a task is selected, and its cosmonaut is to go to the start. It needs
what tests/browser needs, and Pillow, which matplotlib brings. The machine should have nothing else
to do. Look at each picture before you keep it.
"""

import io
import sys
import tempfile
from base64 import b64decode
from pathlib import Path

from PIL import Image
from selenium.webdriver.common.action_chains import ActionChains

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "helpers")]

from browser import Browser, Page  # noqa: E402
from running_session import RunningSession  # noqa: E402

SIZE = (1280, 800)
COLOURS = 256
PORT = "24500"
#: By seat: what must be known before the picture is taken.
SHOWN = {
    "space": ("uplink_video.age_ms", "haptic.up.latency_ms.p50"),
    "ground": ("downlink_video.age_ms", "uplink_video.age_ms"),
}
#: Text of an element that has its value.
_SHOWN = "!['–', ''].includes(document.querySelector({!r})?.textContent ?? '')"
#: A picture that must not be taken for the present spoils a screenshot, and so does a lost link.
_LIVE = (
    "document.querySelector('[data-stale=true]') === null && document.body.dataset.link !== 'lost'"
)
#: Whether the hand steers and feels a force that can be seen.
_FELT = (
    "document.querySelector('hand-panel').dataset.steers === 'true'"
    " && parseFloat(document.querySelector('.force-words strong').textContent) > 1"
)
#: Pages of the mission in the order in which they act, what they write, and what comes of it.
DEEDS = (
    ("k2cp", "Ready for the first task.", ""),
    ("top", "Aiming is next. Hold the start position, please.", "select"),
    ("panel", "", "take"),
    ("k2sv", "Loss of signal in eight minutes.", "take"),
    ("top", "", "take"),
    ("k2cp", "", "take"),
)
_PHASE = "document.querySelector('experiment-panel').dataset.phase === '{}'"
_MODE = "document.querySelector('panel-status').dataset.mode === '{}'"
#: Writes a line into the chat.
_SAY = """
    document.querySelector("chat-panel input").value = arguments[0];
    document.querySelector("chat-panel form").requestSubmit();
"""
#: Pixels of the map: from the middle to the wall, and into it.
ACROSS, INTO = 28, 8
TRIES = 20


def main() -> None:
    """Take all, or those of the seats that are named."""
    seats = sys.argv[1:] or ["space", "ground", "mission"]
    if "space" in seats:
        _sit("space", "--joystick", "page")
    if "ground" in seats:
        _sit("ground")
    if "mission" in seats:
        _do_a_task()


def _sit(seat: str, *options: str) -> None:
    options += ("--radio", "iss-overhead", "--page", PORT)
    with (
        tempfile.TemporaryDirectory() as directory,
        RunningSession("spacejustin", *options, directory=directory) as session,
        Browser(size=SIZE, scale=1) as browser,
    ):
        page = _open(browser, session.pages()[seat])
        for figure in SHOWN[seat]:
            page.wait(_SHOWN.format(f"[data-figure='{figure}']"))
        if seat == "space":
            page.wait("document.querySelector('.joystick-state')?.textContent === 'application'")
            _press(page, ACROSS)
        # Charts and contacts fill.
        page.run("return new Promise((done) => setTimeout(done, 12_000))")
        for theme in ("dark", "light"):
            _take(page, f"seat-{seat}-{theme}", theme)
        browser.assert_no_errors()


def _do_a_task() -> None:
    options = ("--tasks", "--joystick", "page", "--radio", "iss-overhead", "--page", PORT)
    with (
        tempfile.TemporaryDirectory() as directory,
        RunningSession("spacejustin", *options, directory=directory) as session,
        Browser(size=SIZE, scale=1) as browser,
    ):
        page = _open(browser, session.pages()["pages"])
        for theme in ("dark", "light"):
            _take(page, f"welcome-{theme}", theme, feel=False)
        page.close()
        # One page at a time: each takes half a core.
        for name, words, after in DEEDS:
            page = _open(browser, session.pages()[name])
            if words:
                page.run(_SAY, words)
            if name == "panel":
                page.wait(_MODE.format("task_info"))
                page.find("#panel-button").click()
                page.wait(_MODE.format("move_to_start"))
            elif after == "select":
                _select(page)
            if after == "take":
                # Telemetry of the gateways comes every ten seconds.
                page.run("return new Promise((done) => setTimeout(done, 4_000))")
                for theme in ("dark", "light"):
                    _take(page, f"{name}-{theme}", theme, feel=False)
            page.close()
        browser.assert_no_errors()


def _select(top: Page) -> None:
    """Select a task until it is offered: on a busy machine a run may end before."""
    for before in range(5):
        top.wait(_PHASE.format("idle"))
        top.find("[data-task=aiming]").click()
        ended = f"document.querySelectorAll('[data-result]')[{before}] !== undefined"
        top.wait(f"{_PHASE.format('offered')} || {ended}")
        if not top.run(f"return {ended}"):
            return
        print(f"selected again, because of {top.find('run-table').text!r}")
    sys.exit("no task was offered")


def _open(browser: Browser, address: str) -> Page:
    page = browser.open(address)
    # The window's size counts its frame; this is the page's.
    metrics = {"width": SIZE[0], "height": SIZE[1], "deviceScaleFactor": 1, "mobile": False}
    browser.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    page.wait(_LIVE)
    return page


def _press(page: Page, pixels: int) -> None:
    """Hold the handle anew, and pull it to the right."""
    driver = page.browser.driver
    surface = page.find(".workspace-map")
    ActionChains(driver).release().perform()
    ActionChains(driver).click_and_hold(surface).perform()
    ActionChains(driver, duration=300).move_by_offset(pixels, 0).perform()


def _feel(page: Page) -> None:
    """Press against the wall; a page that stalls for 100 ms lets the handle go."""
    for _ in range(TRIES):
        _press(page, INTO)
        page.run("return new Promise((done) => setTimeout(done, 300))")
        if page.run(f"return {_FELT}"):
            return


def _take(page: Page, name: str, theme: str, *, feel: bool = True) -> None:
    driver = page.browser.driver
    scheme = {"features": [{"name": "prefers-color-scheme", "value": theme}]}
    driver.execute_cdp_cmd("Emulation.setEmulatedMedia", scheme)
    page.run("return new Promise((done) => setTimeout(done, 800))")
    feel = feel and page.run("return document.querySelector('hand-panel') !== null")
    for _ in range(TRIES):
        if feel:
            _feel(page)
        page.wait(_LIVE)
        # Before, because taking it stalls the page, too.
        felt = not feel or page.run(f"return {_FELT}")
        told = driver.execute_cdp_cmd("Page.captureScreenshot", {"optimizeForSpeed": True})
        if felt:
            break
    else:
        sys.exit(f"{name}: the page lets go of the handle each time: the machine is too busy")
    picture = Image.open(io.BytesIO(b64decode(told["data"]))).convert("RGB")
    path = ROOT / "docs" / "images" / f"{name}.png"
    picture.quantize(COLOURS, kmeans=1).save(path, optimize=True)
    print(f"{path.relative_to(ROOT)}: {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
