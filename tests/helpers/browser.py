"""Headless Chromium as a person uses it, by selenium and Debian's own driver.

Everything of a browser lies in one directory, and all its processes are in one session of the
kernel, so that its exit leaves neither. No program is downloaded.
"""

import base64
import contextlib
import json
import os
import shutil
import signal
import subprocess
import tempfile
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np
import running_session

from pipelines.session.command_process import end_with_parent

#: Protects against a hang. A browser whose pictures are drawn by the processor needs more of it.
TIMEOUT_S = 150.0
PROGRAMS = ("chromium", "chromedriver")
#: Chromium's words for a server that does not answer.
_NO_ANSWER = "net::ERR_"


def missing():
    """Return in one line what these tests lack; None if nothing."""
    for name in PROGRAMS:
        if shutil.which(name) is None:
            return f"{name}: apt-get install chromium chromium-driver"
    return None if find_spec("selenium") else "selenium: pip install selenium"


#: Whether a seat's page shows the present.
LIVE = "document.querySelector('#picture').dataset.stale === 'false'"


class Browser:
    """One Chromium with windows and tabs. Its exit ends all its processes in any case.

    camera: a .y4m or .mjpeg file for the camera; a moving pattern without it.
    microphone: a .wav file for the microphone; beeps without it.
    devices: False for a machine that has neither camera nor microphone.
    scale: pixels a side of what a page takes for one. A half takes two thirds of the time; the
    canvases of pictures keep their own size.
    """

    def __init__(
        self,
        *,
        camera=None,
        microphone=None,
        devices=True,
        flags=(),
        size=(900, 640),
        scale=0.5,
    ):
        from selenium import webdriver
        from selenium.webdriver.chrome.service import Service

        self.directory = Path(tempfile.mkdtemp(prefix="kavb"))
        options = webdriver.ChromeOptions()
        options.binary_location = str(self._write_starter())
        for flag in (
            "headless=new",
            "no-sandbox",
            # Without a graphics card its emulation would take a core.
            "disable-gpu",
            # Chromium's address bar has pages of its own, which draw as much as ours.
            "disable-features=WebUIOmniboxPopup,WebUIOmniboxAimPopup",
            f"force-device-scale-factor={scale}",
            f"user-data-dir={self.directory / 'profile'}",
            f"window-size={size[0]},{size[1]}",
            "use-fake-ui-for-media-stream",
            "autoplay-policy=no-user-gesture-required",
            *(["use-fake-device-for-media-stream"] if devices else []),
            *([f"use-file-for-fake-video-capture={camera}"] if camera else []),
            *([f"use-file-for-fake-audio-capture={microphone}"] if microphone else []),
            *flags,
        ):
            options.add_argument(f"--{flag}")
        options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
        # A path, or selenium would look for a driver of its own on the Internet.
        self._service = Service(
            shutil.which("chromedriver"),
            env={**os.environ, "TMPDIR": str(self.directory)},
            log_output=subprocess.DEVNULL,
            popen_kw={
                "start_new_session": True,
                "preexec_fn": end_with_parent,
            },
        )
        self._errors = []
        try:
            self.driver = webdriver.Chrome(options=options, service=self._service)
            self.driver.set_script_timeout(TIMEOUT_S)
            self.driver.set_page_load_timeout(TIMEOUT_S)
        except BaseException:
            self.end()
            raise

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.end()

    def end(self):
        """End all processes and remove all files."""
        _signal(self.pids(), signal.SIGKILL)
        if getattr(self._service, "process", None) is not None:
            self._service.process.wait()
        eventually(lambda: self.pids() == [], "the browser's end")
        shutil.rmtree(self.directory, ignore_errors=True)

    def _write_starter(self):
        """Write what starts a Chromium that ends with its driver, also when that is killed."""
        path = self.directory / "chromium"
        path.write_text(
            f'#!/bin/sh\nexec setpriv --pdeathsig KILL {shutil.which("chromium")} "$@"\n'
        )
        path.chmod(0o700)
        return path

    def pids(self):
        """Return the pids of the driver and of all processes of Chromium."""
        driver = getattr(self._service, "process", None)
        return [] if driver is None else _of_session(driver.pid)

    def open(self, url, kind="window"):
        """Open an address in a new window, or in a tab that hides the one that was seen."""
        # The first window stays empty: a browser ends with its last one.
        self.driver.switch_to.new_window(kind)
        page = Page(self, self.driver.current_window_handle)
        self.driver.get(url)
        return page

    @contextlib.contextmanager
    def stalled(self):
        """Stop all processes of Chromium, as on a machine that sleeps; then let them go on."""
        driver = self._service.process.pid
        pids = [pid for pid in self.pids() if pid != driver]
        try:
            _signal(pids, signal.SIGSTOP)
            yield
        finally:
            _signal(pids, signal.SIGCONT)

    def errors(self):
        """Return every error that any page's console has shown so far, workers' included."""
        for entry in self.driver.get_log("browser"):
            if entry["level"] == "SEVERE":
                self._errors.append(entry)
        return [f"{entry['source']}: {entry['message']}" for entry in self._errors]

    def begin_anew(self):
        """Close all pages, and forget their errors."""
        first, *others = self.driver.window_handles
        for handle in others:
            self.driver.switch_to.window(handle)
            self.driver.close()
        self.driver.switch_to.window(first)
        self.errors()
        self._errors.clear()

    def assert_no_errors(self, *, server_gone=False):
        """Assert that no script failed. server_gone: the test took the server away."""
        found = [error for error in self.errors() if not (server_gone and _NO_ANSWER in error)]
        assert found == []


class Page:
    """A window or a tab of a browser."""

    def __init__(self, browser, handle):
        self.browser, self._handle = browser, handle

    def run(self, script, *values):
        """Run a script as a function's body in the page; return what it returns."""
        return self.driver().execute_script(script, *values)

    def wait(self, condition, what=None):
        """Wait until an expression in the page is true; return its value."""
        return eventually(lambda: self.run(f"return {condition}"), what or condition)

    def find(self, selector):
        """Return the one element that a CSS selector names."""
        (element,) = self.driver().find_elements("css selector", selector)
        return element

    def close(self):
        """Close the window or tab."""
        self.driver().close()
        self.browser.driver.switch_to.window(self.browser.driver.window_handles[0])

    def pixels(self, selector="#picture", width=None, height=None):
        """Return a canvas's pixels from its upper left corner, shape (height, width, 3), RGB."""
        script = """
            const canvas = document.querySelector(arguments[0]);
            const width = arguments[1] ?? canvas.width, height = arguments[2] ?? canvas.height;
            const { data } = canvas.getContext("2d").getImageData(0, 0, width, height);
            let text = "";
            for (let at = 0; at < data.length; at += 8192) {
              text += String.fromCharCode(...data.subarray(at, at + 8192));
            }
            return [width, height, btoa(text)];
        """
        width, height, data = self.run(script, selector, width, height)
        rgba = np.frombuffer(base64.b64decode(data), np.uint8).reshape(height, width, 4)
        return rgba[:, :, :3].copy()

    def figure(self, name):
        """Return a figure that the page shows: a number, a word, or None while there is none."""
        text = self.run(
            "return document.querySelector(`[data-figure='${arguments[0]}']`)?.textContent", name
        )
        try:
            return json.loads(text)
        except (TypeError, ValueError):
            return text

    def screenshot(self, path):
        """Write what a person sees as a PNG file."""
        Path(path).write_bytes(self.driver().get_screenshot_as_png())

    def load(self, url, script):
        """Load another address, and run a script before all of its own."""
        driver = self.driver()
        driver.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": script})
        driver.get(url)

    def show(self):
        """Bring it to the front. A tab hides the one that was seen."""
        self.driver()

    def reload(self, script):
        """Load the page anew, and run a script before all of its own."""
        driver = self.driver()
        driver.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": script})
        driver.refresh()

    def fit(self, width, height=844, scale=1, **more):
        """Give the page a screen of its own."""
        metrics = {"width": width, "height": height, "deviceScaleFactor": scale, "mobile": False}
        driver = self.driver()
        driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", {**metrics, **more})

    def driver(self):
        """Return selenium's driver, with this page in front."""
        driver = self.browser.driver
        # To switch moves the focus and shows a hidden tab, so not without need.
        if driver.current_window_handle != self._handle:
            driver.switch_to.window(self._handle)
        return driver


def eventually(ask, what):
    """Call `ask()` until its result is true; return the result."""
    return running_session.eventually(ask, what, TIMEOUT_S)


def drawn(page):
    """Return how many pictures the main view of a seat's page has drawn."""
    return page.run("return document.querySelector('picture-view').drawn")


def wait_for_pictures(page, count=5):
    """Wait until a seat's page has drawn that many more pictures."""
    before = drawn(page)
    eventually(lambda: drawn(page) >= before + count, "new pictures")


def luma(pixels):
    """Return the luma of RGB pixels as video has it, 16 to 235, shape (height, width), uint8."""
    height, width = (size // 2 * 2 for size in pixels.shape[:2])
    return cv2.cvtColor(pixels[:height, :width], cv2.COLOR_RGB2YUV_I420)[:height]


def psnr_db(one, other):
    """Return the likeness of two pictures of one shape; infinite if they are equal."""
    return cv2.PSNR(one, other) if (one != other).any() else float("inf")


def _signal(pids, number):
    for pid in pids:
        # A process may end at any time.
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, number)


def _of_session(leader):
    """Return the pids of the living processes of a session of the kernel."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, _, session = stat.read_text().rpartition(")")[2].split()[:4]
        except OSError:
            continue
        if int(session) == leader and state != "Z":
            found.append(int(stat.parent.name))
    return found
