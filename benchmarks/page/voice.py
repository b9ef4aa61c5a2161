"""From the microphone of ground control's page to the loudspeaker of the operator's page."""

from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from time import monotonic, sleep

from benchmarks.page.browser import Browser
from benchmarks.page.screen import VirtualScreen
from benchmarks.page.session import TIMEOUT_S, live_session

_LOOK_S = 0.1
_SETTLE_S = 3.0
_TURN_ON = "document.querySelector('microphone-panel button').click()"
_HEARD = "return document.querySelector('microphone-panel').dataset.heard === 'true'"
_AGE = "return document.querySelector('[data-figure=\"uplink_voice.age_ms\"]').textContent"


def voice_run(*, seconds: float, base_port: int) -> list[float]:
    """Return ages in ms: since what the worklet plays was captured by the other page.

    A live session and both pages share this machine. The microphone is Chromium's own, a beep a
    second. The age is by the page's estimate of the session's clock. RuntimeError if nothing is
    heard.
    """
    ages_ms: list[float] = []
    with ExitStack() as stack:
        folder = Path(stack.enter_context(TemporaryDirectory()))
        screen = stack.enter_context(VirtualScreen(1800, 900, folder))
        words = ["--base-port", str(base_port), "--radio", "clean"]
        live = stack.enter_context(live_session(words, seconds + 2 * TIMEOUT_S))
        browser = stack.enter_context(Browser(screen.display, flags=["--window-size=900,800"]))
        browser.open(live.url("ground"), left=0, top=0, width=880, height=800)
        _wait(browser, "return document.body.dataset.link === 'connected'")
        browser.driver.execute_script(_TURN_ON)
        _wait(browser, _HEARD)
        browser.new_window()
        browser.open(live.url("space"), left=900, top=0, width=880, height=800)
        _wait(browser, f"return !isNaN(parseInt({_AGE.removeprefix('return ')}))")
        sleep(_SETTLE_S)
        until_s = monotonic() + seconds
        while monotonic() < until_s:
            text = browser.driver.execute_script(_AGE)
            if text.isdecimal():
                ages_ms.append(float(text))
            sleep(_LOOK_S)
    if not ages_ms:
        raise RuntimeError("the operator's page hears nothing")
    return ages_ms


def _wait(browser: Browser, script: str) -> None:
    until_s = monotonic() + TIMEOUT_S
    while not browser.driver.execute_script(script):
        if monotonic() > until_s:
            raise RuntimeError(f"waited in vain for: {script}")
        sleep(_LOOK_S)
