"""From the topic to the pixel: windows on a virtual screen, whose numbers another process reads."""

import multiprocessing
import socket
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from time import monotonic, sleep
from typing import Any, TypeVar

from benchmarks.page.alone import cpu_s, forked, page_alone, publish
from benchmarks.page.browser import Browser
from benchmarks.page.footage import FPS
from benchmarks.page.page_metrics import OURS, PEER, ViewRun
from benchmarks.page.screen import Spot, VirtualScreen, watch
from benchmarks.page.webrtc import serve_webrtc
from kontur_av.clock import NS_PER_MS
from pipelines.bench.course.marks import NUMBERS
from pipelines.report.result import spread
from pipelines.session.setup.segments import Segment

_WIDTH, _HEIGHT = 820, 1000
#: Until a window has a picture.
_TIMEOUT_S = 30.0
#: After the last window, before anything counts.
_SETTLE_S = 2.0

Found = TypeVar("Found")


def measured(
    who: str, views: int, units: list[tuple[bytes, bool]], seconds: float
) -> tuple[ViewRun, list[float]]:
    """Show `units` in `views` windows, and measure for `seconds`; the run, and all delays in ms.

    RuntimeError if a window shows no picture.
    """
    published = numbers()
    seen = [numbers() for _ in range(views)]
    ended = multiprocessing.RawValue("b", 0)
    with ExitStack() as stack:
        folder = Path(stack.enter_context(TemporaryDirectory()))
        screen = stack.enter_context(VirtualScreen(_WIDTH * views, _HEIGHT, folder))
        if who == OURS:
            page = stack.enter_context(page_alone(Segment.SPACE))
            topic = page.topology.video("uplink_video").coded_topic
            stack.enter_context(forked(publish, page.session, topic, units, published))
            url, server = page.listener.url("space"), page.pid
        else:
            listener = stack.enter_context(socket.create_server(("127.0.0.1", 0)))
            server = stack.enter_context(forked(serve_webrtc, listener, units, published))
            url = f"http://127.0.0.1:{listener.getsockname()[1]}/"
        browser = stack.enter_context(Browser(screen.display))
        spots: list[Spot] = []
        joins: list[float] = []
        for view in range(views):
            if view:
                browser.new_window()
            browser.open(url, left=view * _WIDTH, top=0, width=_WIDTH - 20, height=_HEIGHT - 40)
            if who == OURS:
                joins.append(wait_for(browser.joined_ms))
            else:
                wait_for(browser.spot)
        sleep(_SETTLE_S)
        # The layout may move until the first figures are there.
        for window in browser.driver.window_handles:
            browser.driver.switch_to.window(window)
            spots.append(wait_for(browser.spot))
        begun_s, begun_cpu_s, first = monotonic(), cpu_s(server), _count(published)
        with forked(watch, screen.file, spots, seen, ended):
            sleep(seconds)
        took_s, took_cpu_s, last = (
            monotonic() - begun_s,
            cpu_s(server) - begun_cpu_s,
            _count(published),
        )
    counted = range(first + 1, max(first + 1, last - FPS // 3))
    delays_ms = [
        (shown[number] - published[number]) / NS_PER_MS
        for shown in seen
        for number in counted
        if shown[number] and published[number]
    ]
    run = ViewRun(
        who=who,
        views=views,
        pixel_ms=spread(delays_ms),
        published=len(counted) * views,
        seen=len(delays_ms),
        join_ms=joins,
        server_cpu=took_cpu_s / took_s if who == OURS else None,
    )
    return run, delays_ms


#: In the order in which they take turns.
CONTENDERS = ((OURS, 1), (PEER, 1), (OURS, 3))


def numbers() -> Any:
    """Return a shared array with an instant in ns for each number; 0 for none."""
    return multiprocessing.RawArray("q", NUMBERS)


def _count(published: Any) -> int:
    """Return how many pictures have been published: they are in order."""
    low, high = 0, NUMBERS
    while low < high:
        middle = (low + high) // 2
        if published[middle]:
            low = middle + 1
        else:
            high = middle
    return low


def wait_for(ask: Callable[[], Found | None]) -> Found:
    """Return what `ask` finds, once it does. RuntimeError if a window shows no picture."""
    until_s = monotonic() + _TIMEOUT_S
    while (found := ask()) is None:
        if monotonic() > until_s:
            raise RuntimeError("a window shows no picture")
        sleep(0.05)
    return found
