"""From the capture to the pixel of a partner's browser, through `kontur-av rtc serve`."""

import json
import multiprocessing
import os
import re
import subprocess
import sys
from contextlib import ExitStack, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from time import sleep
from typing import Any

from benchmarks.page.alone import forked
from benchmarks.page.browser import Browser
from benchmarks.page.footage import FPS, HEIGHT, WIDTH, pictures
from benchmarks.page.screen import VirtualScreen, watch
from benchmarks.page.views import numbers, wait_for
from benchmarks.rtc.rtc_metrics import PixelRun
from kontur_av.clock import NS_PER_MS, NS_PER_S, MonotonicClock
from pipelines.report.result import spread
from pipelines.session.command_process import end_all

_VIDEO = "video[data-programme=main]"
_SCREEN = 820, 1000
#: For the browser to start, beside the measured time.
SPARE_S = 40.0
_SETTLE_S = 3.0
_HEADER = b"YUV4MPEG2 W%d H%d F%d:1 Ip A1:1 C420jpeg\n" % (WIDTH, HEIGHT, FPS)


def pixel_run(seconds: float, port: int) -> PixelRun:
    """Show numbered pictures in Chromium for `seconds`. RuntimeError if it shows none."""
    captured, seen = numbers(), numbers()
    ended = multiprocessing.RawValue("b", 0)
    with ExitStack() as stack:
        folder = Path(stack.enter_context(TemporaryDirectory()))
        fifo, report = folder / "pictures", folder / "report.json"
        os.mkfifo(fifo)
        screen = stack.enter_context(VirtualScreen(*_SCREEN, folder))
        count = round((seconds + SPARE_S) * FPS)
        stack.enter_context(forked(_film, fifo, count, captured))
        command = [sys.executable, "-m", "pipelines.cli", "rtc", "serve", "--http", str(port)]
        command += ["--video", f"pipe:{fifo}", "--fps", str(FPS), "--report", str(report)]
        server = subprocess.Popen(command, stdout=subprocess.PIPE, start_new_session=True)
        stack.callback(end_all, [server])
        browser = stack.enter_context(Browser(screen.display))
        browser.open(_page(server), left=0, top=0, width=800, height=960)
        wait_for(lambda: browser.spot(_VIDEO))
        sleep(_SETTLE_S)
        spot = wait_for(lambda: browser.spot(_VIDEO))
        first = _newest(captured)
        with forked(watch, screen.file, [spot], [seen], ended):
            sleep(seconds)
        last = _newest(captured)
        end_all([server])
        told = json.loads(report.read_text())
    # The newest may still be under way.
    counted = range(first + 1, max(first + 1, last - FPS // 3))
    delays_ms = [(seen[one] - captured[one]) / NS_PER_MS for one in counted if seen[one]]
    return PixelRun(
        pixel_ms=spread(delays_ms),
        captured=len(counted),
        seen=len(delays_ms),
        round_trip_ms=told["last"]["sent"]["video"].get("round_trip_ms"),
    )


def _page(server: "subprocess.Popen[bytes]") -> str:
    assert server.stdout is not None
    for line in server.stdout:
        if found := re.fullmatch(r"page (\S+)\n", line.decode()):
            return found[1]
    raise RuntimeError("`kontur-av rtc serve` did not start")


def _newest(captured: Any) -> int:
    return max((number for number, at_ns in enumerate(captured) if at_ns), default=0)


def _film(fifo: Path, count: int, captured: Any) -> None:
    """Write numbered pictures at their rate; note each one's instant in ns. For its own process."""
    clock = MonotonicClock()
    # For reading, too, so that it opens at once.
    pipe = os.open(fifo, os.O_RDWR)
    with suppress(KeyboardInterrupt):
        _write(pipe, _HEADER)
        due_ns = clock.now_ns()
        for number, picture in enumerate(pictures(count)):
            octets = b"FRAME\n" + picture.tobytes()
            clock.sleep_until_ns(due_ns)
            captured[number] = clock.now_ns()
            _write(pipe, octets)
            # As a camera: after a full pipe it goes on from there, and does not hurry.
            due_ns = max(due_ns + NS_PER_S // FPS, clock.now_ns())


def _write(pipe: int, octets: bytes) -> None:
    rest = memoryview(octets)
    while rest:
        rest = rest[os.write(pipe, rest) :]
