"""The pointer that moves a page's hand: from its event to the topic that the joystick reads."""

import ctypes
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from time import monotonic, sleep
from typing import Any

from benchmarks.page.alone import forked, page_alone, publish
from benchmarks.page.browser import Browser
from benchmarks.page.screen import VirtualScreen
from benchmarks.page.session import TIMEOUT_S, live_session
from benchmarks.page.views import numbers
from kontur_av.clock import NS_PER_MS, MonotonicClock
from kontur_av.topics.bus import Reader, TopicBus
from pipelines.hand.hand_topics import HAND_INPUT_TOPIC
from pipelines.session.setup.segments import Segment
from telepresence.haptics.device.page import PageInput

_STEP_S = 0.025
_STEP_PIXELS = 3
#: Of the half workspace: what counts as a move.
_LEAST_MOVE = 1e-3
#: Between two looks at the topic. A hand is dated at most this much too late.
_LOOK_NS = NS_PER_MS // 5
_GIVEN_UP_NS = 200 * NS_PER_MS
_SETTLE_S = 3.0
_MAP = "return document.querySelector('.workspace-map').getBoundingClientRect().toJSON()"
_TOP = "return [window.screenX, window.screenY + window.outerHeight - window.innerHeight]"


def pointer_run(
    units: list[tuple[bytes, bool]] | None, *, seconds: float, base_port: int
) -> list[float]:
    """Move the pointer over the page's map; the delays in ms until it is a hand.

    units: what the page shows meanwhile, without the rest of a session; None for a live session on
    the same cores. RuntimeError if the hand does not follow.
    """
    with ExitStack() as stack:
        folder = Path(stack.enter_context(TemporaryDirectory()))
        screen = stack.enter_context(VirtualScreen(1300, 1000, folder))
        if units is None:
            words = ["--base-port", str(base_port), "--joystick", "page"]
            live = stack.enter_context(live_session(words, seconds + 2 * TIMEOUT_S))
            url, session = live.url("space"), live.name
        else:
            page = stack.enter_context(page_alone(Segment.SPACE))
            topic = page.topology.video("uplink_video").coded_topic
            stack.enter_context(forked(publish, page.session, topic, units, numbers()))
            url, session = page.listener.url("space"), page.session
        browser = stack.enter_context(Browser(screen.display))
        browser.open(url, left=0, top=0, width=1280, height=960)
        until_s = monotonic() + TIMEOUT_S
        while browser.joined_ms() is None:
            if monotonic() > until_s:
                raise RuntimeError("the page shows no picture")
            sleep(0.1)
        sleep(_SETTLE_S)
        box: Any = browser.driver.execute_script(_MAP)
        left, top = browser.driver.execute_script(_TOP)
        x = round(left + box["x"] + box["width"] / 2)
        y = round(top + box["y"] + box["height"] / 2)
        bus = stack.enter_context(TopicBus.join(session))
        delays_ms = _moved(_Pointer(screen.display), x, y, bus.reader(HAND_INPUT_TOPIC), seconds)
    if not delays_ms:
        raise RuntimeError("the hand does not follow the pointer")
    return delays_ms


def _moved(pointer: "_Pointer", x: int, y: int, reader: Reader, seconds: float) -> list[float]:
    clock = MonotonicClock()
    delays_ms: list[float] = []
    pointer.move(x, y)
    pointer.press()
    sleep(0.5)
    for number in range(round(seconds / _STEP_S)):
        old = _newest(reader)
        begun_ns = clock.now_ns()
        pointer.move(x + (_STEP_PIXELS if number % 2 else -_STEP_PIXELS), y)
        while clock.now_ns() - begun_ns < _GIVEN_UP_NS:
            # To spin would take a core from the browser.
            clock.sleep_until_ns(clock.now_ns() + _LOOK_NS)
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
    return delays_ms


def _newest(reader: Reader) -> PageInput | None:
    lease = reader.latest()
    if lease is None:
        return None
    with lease:
        return HAND_INPUT_TOPIC.unpack(lease.octets())


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
