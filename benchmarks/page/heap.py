"""What a page that stays open keeps: memory, nodes and listeners."""

from time import monotonic, sleep

from benchmarks.page.browser import Browser
from benchmarks.page.page_metrics import HeapRun, HeapSample
from benchmarks.page.session import TIMEOUT_S, live_session

#: The first sample is taken after this time: histories of a minute are full by then.
FULL_S = 90.0
_EVERY_S = 30.0


def heap_run(seat: str, *, seconds: float, base_port: int) -> HeapRun:
    """Open a seat of a live session for `seconds`; look each 30 s, after a garbage collection."""
    words = ["--base-port", str(base_port), "--radio", "clean"]
    samples: list[HeapSample] = []
    with live_session(words, seconds + TIMEOUT_S) as live, Browser(None) as browser:
        browser.driver.get(live.url(seat))
        browser.driver.execute_cdp_cmd("Performance.enable", {})
        begun_s = monotonic()
        sleep(min(FULL_S, seconds))
        while True:
            browser.driver.execute_cdp_cmd("HeapProfiler.collectGarbage", {})
            found = browser.driver.execute_cdp_cmd("Performance.getMetrics", {})["metrics"]
            value = {row["name"]: row["value"] for row in found}
            samples.append(
                HeapSample(
                    at_s=monotonic() - begun_s,
                    heap_octets=round(value["JSHeapUsedSize"]),
                    nodes=round(value["Nodes"]),
                    listeners=round(value["JSEventListeners"]),
                )
            )
            if monotonic() - begun_s >= seconds:
                return HeapRun(seat=seat, samples=samples)
            sleep(min(_EVERY_S, max(0.0, begun_s + seconds - monotonic())))
