"""Live sessions with and without pages."""

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from time import monotonic, sleep

from benchmarks.json_reader import JsonReader
from benchmarks.page.alone import forked
from benchmarks.page.browser import Browser
from benchmarks.page.page_metrics import SessionRun
from benchmarks.page.watcher import watch_seat
from kontur_av.topics.session_files import session_root
from pipelines.session.command_process import end_all

#: For a session to begin or to end, and for a page to show a picture.
TIMEOUT_S = 60.0
_SETUP = "spacejustin"
#: How a session's pages are: absent, served, read by a program that draws nothing, or in Chromium.
PAGES = ("none", "nobody looks", "one reader", "open here")


class Session:
    """A running `kontur-av stream`. name: of the session. report: the file that it writes."""

    def __init__(self, process: subprocess.Popen[bytes], report: Path) -> None:
        self.process, self.report = process, report
        self.name = f"{_SETUP}-{process.pid}"

    def url(self, seat: str) -> str:
        """Return the address of a seat, once it is known."""
        until_s = monotonic() + TIMEOUT_S
        file = session_root(self.name) / "pages.json"
        while not file.exists():
            if monotonic() > until_s or self.process.poll() is not None:
                raise RuntimeError("the session does not serve its pages")
            sleep(0.05)
        url: str = json.loads(file.read_text())[seat]
        return url


@contextmanager
def live_session(words: list[str], seconds: float) -> Iterator[Session]:
    """Run `kontur-av stream` with these options for at most `seconds`."""
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
            yield Session(process, report)
        finally:
            end_all([process])


def session_run(page: str, *, seconds: float, base_port: int) -> SessionRun:
    """Run a session. page: one of PAGES."""
    words = ["--base-port", str(base_port), "--radio", "clean"]
    words += ["--no-page"] if page == "none" else []
    with live_session(words, seconds) as session, ExitStack() as stack:
        if page == "one reader":
            stack.enter_context(forked(watch_seat, session.url("space")))
        elif page == "open here":
            browser = stack.enter_context(Browser(None))
            browser.driver.get(session.url("space"))
        session.process.wait(seconds + TIMEOUT_S)
        report = JsonReader(json.loads(session.report.read_text()))
    latency = report.at("streams", "uplink_video", "latency_ms")
    page_cpu = None
    if page != "none":
        page_cpu = report.number("processes", "page_space", "cpu_s") / report.number("seconds")
    return SessionRun(
        page=page,
        page_cpu=page_cpu,
        session_cpu=report.number("cpu", "cores_used"),
        video_p50_ms=latency.number("p50"),
        video_p99_ms=latency.number("p99"),
        slot_p99_us=report.number("link", "uplink", "lateness_us", "p99"),
    )
