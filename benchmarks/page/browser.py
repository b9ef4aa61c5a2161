"""Chromium on a virtual screen, with windows side by side, through selenium."""

import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from benchmarks.page.screen import Spot
from kontur_av.errors import ConfigError

if TYPE_CHECKING:
    pass

#: Notes in every page when its picture is live for the first time, in ms since the page was opened.
_NOTE_JOIN = """
new MutationObserver((changes) => {
  for (const change of changes) {
    if (change.target.id === "picture" && change.target.dataset.stale === "false") {
      window.konturJoinedMs ??= performance.now();
    }
  }
}).observe(document, { attributes: true, subtree: true, attributeFilter: ["data-stale"] });
"""
_SPOT = """
const picture = document.querySelector(arguments[0]);
if (picture === null) return [0, 0, 1, 0];
const box = picture.getBoundingClientRect();
const wide = picture.videoWidth || picture.width;
return [
  window.screenX + (window.outerWidth - window.innerWidth) / 2 + box.left,
  window.screenY + window.outerHeight - window.innerHeight + box.top,
  box.width / wide,
  wide,
];
"""


def lacking() -> str:
    """Say in one line what is missing for this bench; "" if nothing is."""
    for program, package in (
        ("chromium", "chromium"),
        ("chromedriver", "chromium-driver"),
        ("Xvfb", "xvfb"),
    ):
        if shutil.which(program) is None:
            return f"{program} is missing: apt-get install {package}"
    try:
        import selenium  # noqa: F401
    except ImportError:
        return "selenium is missing: pip install 'kontur-av[bench]'"
    return ""


class Browser:
    """Chromium with one window or more; a context manager.

    display: of the screen; None for headless.
    flags: further switches of Chromium.
    """

    def __init__(self, display: str | None, *, flags: Sequence[str] = ()) -> None:
        why = lacking()
        if why:
            raise ConfigError(why)
        from selenium.webdriver import Chrome, ChromeOptions
        from selenium.webdriver.chrome.service import Service

        options = ChromeOptions()
        options.binary_location = str(shutil.which("chromium"))
        for flag in (
            "--no-sandbox",
            "--no-first-run",
            "--disable-extensions",
            "--disable-infobars",
            # The peer must learn this machine's address.
            "--disable-features=WebRtcHideLocalIpsWithMdns",
            "--use-fake-ui-for-media-stream",
            "--use-fake-device-for-media-stream",
            "--autoplay-policy=no-user-gesture-required",
            # A virtual screen has no refresh: draw at once.
            "--disable-gpu-vsync",
            "--disable-frame-rate-limit",
            *(["--headless=new"] if display is None else []),
            *flags,
        ):
            options.add_argument(flag)
        environment = {"PATH": "/usr/local/bin:/usr/bin:/bin", "HOME": str(Path.home())}
        if display is not None:
            environment["DISPLAY"] = display
        service = Service(str(shutil.which("chromedriver")), env=environment)
        self.driver: Chrome = Chrome(options=options, service=service)
        self.driver.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": _NOTE_JOIN})

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.driver.quit()

    def open(self, url: str, *, left: int, top: int, width: int, height: int) -> None:
        """Show `url` in the present window, at this place of the screen."""
        self.driver.set_window_rect(left, top, width, height)
        self.driver.get(url)

    def new_window(self) -> None:
        """Go on in a new window."""
        self.driver.switch_to.new_window("window")
        self.driver.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": _NOTE_JOIN})

    def spot(self, selector: str = "#picture") -> Spot | None:
        """Return where the present window's picture is; None while there is none."""
        left, top, scale, wide = self.driver.execute_script(_SPOT, selector)
        return Spot(left=left, top=top, scale=scale) if wide > 1 else None

    def joined_ms(self) -> float | None:
        """Return when the present page's picture was live first, in ms since it was opened."""
        found: Any = self.driver.execute_script("return window.konturJoinedMs ?? null")
        return None if found is None else float(found)
