"""Live sessions with and without pages, and the pointer that moves a page's hand."""

import ctypes
import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from time import monotonic, sleep
from typing import Any

from kontur_av.clock import NS_PER_MS, MonotonicClock
from kontur_av.topics.bus import Reader, TopicBus
from kontur_av.topics.session_files import session_root
from pipelines.bench.children import end_all
from pipelines.bench.page.browser import Browser
from pipelines.bench.page.figures import SessionRun
from pipelines.bench.page.screen import VirtualScreen
from pipelines.bench.result import JsonReader
from pipelines.cores.hand_topics import unpack_input
from pipelines.topology import HAND_INPUT_TOPIC
from telepresence.haptics.device.page import PageInput

_PATIENCE_S = 60.0
_SETUP = "spacejustin"
_STEP_S = 0.025
_STEP_PIXELS = 3
#: Of the half workspace: what counts as a move.
_LEAST_MOVE = 1e-3
_GIVEN_UP_NS = 200 * NS_PER_MS
_MAP = "return document.querySelector('workspace-map').getBoundingClientRect().toJSON()"
_TOP = "return [window.screenX, window.screenY + window.outerHeight - window.innerHeight]"


class _Session:
    """A running `kontur-av stream`. name: of the session. report: the file that it writes."""

    def __init__(self, process: subprocess.Popen[bytes], report: Path) -> None:
        self.process, self.report = process, report
        self.name = f"{_SETUP}-{process.pid}"

    def url(self, seat: str) -> str:
        """Return the address of a seat, once it is known."""
        until_s = monotonic() + _PATIENCE_S
        file = session_root(self.name) / "pages.json"
        while not file.exists():
            if monotonic() > until_s or self.process.poll() is not None:
                raise RuntimeError("the session does not serve its pages")
            sleep(0.05)
        url: str = json.loads(file.read_text())[seat]
        return url


@contextmanager
def _session(words: list[str], seconds: float) -> Iterator[_Session]:
    with TemporaryDirectory() as folder:
        report = Path(folder) / "report.json"
        command = [sys.executable, "-m", "pipelines.cli", "stream", "--setup", _SETUP, "-q"]
        command += ["--seconds", f"{seconds:g}", "--report", str(report), *words]
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        try:
            yield _Session(process, report)
        finally:
            end_all([process])


def session_run(page: str, *, seconds: float, base_port: int) -> SessionRun:
    """Run a session. page: "none", "nobody looks" or "open" (in a headless Chromium)."""
    words = ["--base-port", str(base_port), "--radio", "clean"]
    words += ["--no-page"] if page == "none" else []
    with _session(words, seconds) as session:
        if page == "open":
            with Browser(None) as browser:
                browser.driver.get(session.url("space"))
                session.process.wait(seconds + _PATIENCE_S)
        else:
            session.process.wait(seconds + _PATIENCE_S)
        report = JsonReader(json.loads(session.report.read_text()))
    latency = report.at("streams", "uplink_video", "latency_ms")
    cpu_s = None if page == "none" else report.number("processes", "page_space", "cpu_s")
    return SessionRun(
        page=page,
        page_cpu=None if cpu_s is None else cpu_s / report.number("seconds"),
        video_p50_ms=latency.number("p50"),
        video_p99_ms=latency.number("p99"),
        slot_p99_us=report.number("link", "uplink", "lateness_us", "p99"),
    )


def pointer_run(*, seconds: float, base_port: int) -> list[float]:
    """Move the pointer over the page's map of a live session; the delays in ms until it is a hand.

    RuntimeError if the hand does not follow.
    """
    clock = MonotonicClock()
    delays_ms: list[float] = []
    words = ["--base-port", str(base_port), "--joystick", "page"]
    with (
        TemporaryDirectory() as folder,
        VirtualScreen(1300, 1000, Path(folder)) as screen,
        _session(words, seconds + 2 * _PATIENCE_S) as session,
        Browser(screen.display) as browser,
    ):
        browser.open(session.url("space"), left=0, top=0, width=1280, height=960)
        until_s = monotonic() + _PATIENCE_S
        while browser.joined_ms() is None:
            if monotonic() > until_s:
                raise RuntimeError("the page shows no picture")
            sleep(0.1)
        sleep(3.0)
        box: Any = browser.driver.execute_script(_MAP)
        left, top = browser.driver.execute_script(_TOP)
        x = round(left + box["x"] + box["width"] / 2)
        y = round(top + box["y"] + box["height"] / 2)
        pointer = _Pointer(screen.display)
        with TopicBus.join(session.name) as bus:
            reader = bus.reader(HAND_INPUT_TOPIC)
            pointer.move(x, y)
            pointer.press()
            sleep(0.5)
            for number in range(round(seconds / _STEP_S)):
                old = _newest(reader)
                begun_ns = clock.now_ns()
                pointer.move(x + (_STEP_PIXELS if number % 2 else -_STEP_PIXELS), y)
                while clock.now_ns() - begun_ns < _GIVEN_UP_NS:
                    new = _newest(reader)
                    if new is None:
                        continue
                    if old is not None and abs(new.x - old.x) > _LEAST_MOVE:
                        delays_ms.append((clock.now_ns() - begun_ns) / NS_PER_MS)
                        break
                    old = new
                # Not in step with anything of the page.
                sleep(_STEP_S * (0.5 + number % 7 / 7))
            pointer.release()
    if not delays_ms:
        raise RuntimeError("the hand does not follow the pointer")
    return delays_ms


def _newest(reader: Reader) -> PageInput | None:
    lease = reader.latest()
    if lease is None:
        return None
    with lease:
        return unpack_input(lease.octets())


class _Pointer:
    """The pointer of a virtual screen, by the XTEST extension."""

    def __init__(self, display: str) -> None:
        self._x11 = ctypes.CDLL("libX11.so.6")
        self._xtst = ctypes.CDLL("libXtst.so.6")
        self._x11.XOpenDisplay.restype = ctypes.c_void_p
        self._display = ctypes.c_void_p(self._x11.XOpenDisplay(display.encode()))

    def move(self, x: int, y: int) -> None:
        """Move to a place of the screen."""
        self._xtst.XTestFakeMotionEvent(self._display, 0, x, y, ctypes.c_ulong(0))
        self._x11.XFlush(self._display)

    def press(self) -> None:
        """Press the first button."""
        self._button(1)

    def release(self) -> None:
        """Release the first button."""
        self._button(0)

    def _button(self, pressed: int) -> None:
        self._xtst.XTestFakeButtonEvent(self._display, 1, pressed, ctypes.c_ulong(0))
        self._x11.XFlush(self._display)
