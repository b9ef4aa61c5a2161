"""What the other tests here rely on, shown on a page that is served by the test."""

import http.server
import threading

import numpy as np
import pytest
from browser import luma
from running_session import alive

PAGE = """<!doctype html><title>A page</title>
<canvas id="picture" width="64" height="48"></canvas><p data-figure="age_ms">12.5</p>
<script>
  const context = picture.getContext("2d");
  context.fillStyle = "rgb(0 128 255)";
  context.fillRect(0, 0, 32, 48);
  window.seen = [];
  document.addEventListener("visibilitychange", () => seen.push(document.visibilityState));
</script>"""
WORKER = "self.onmessage = () => { throw new Error('the worker fell'); };"


@pytest.fixture
def address():
    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            files = {"/": ("text/html", PAGE), "/worker.js": ("text/javascript", WORKER)}
            kind, text = files.get(self.path, ("text/plain", ""))
            self.send_response(200)
            self.send_header("Content-Type", kind)
            self.end_headers()
            self.wfile.write(text.encode())

        def log_message(self, *_):
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}/"
        server.shutdown()
        thread.join()


def test_a_browser_shows_what_its_pages_show_and_leaves_nothing(start_browser, address):
    browser = start_browser()
    page = browser.open(address)
    pixels = page.pixels()
    assert pixels.shape == (48, 64, 3)
    assert np.array_equal(pixels[0, 0], [0, 128, 255])
    assert abs(int(luma(pixels)[0, 0]) - 107) <= 1
    assert page.figure("age_ms") == 12.5 and page.figure("nothing") is None
    tab = browser.open(address, "tab")
    assert tab.run("return document.visibilityState") == "visible"
    tab.close()
    assert page.wait("seen.length === 2 && seen") == ["hidden", "visible"]
    with browser.stalled():
        assert browser.pids() != []
    browser.assert_no_errors()
    # An error fails a test, also where nobody caught it: in a timer, or in a worker.
    page.run("setTimeout(() => missing(), 0); new Worker('worker.js').postMessage(1);")
    page.wait("true")
    found = []
    while len(found) < 2:
        found = browser.errors()
    assert "missing is not defined" in found[0]
    assert "the worker fell" in found[1]
    with pytest.raises(AssertionError):
        browser.assert_no_errors()
    pids, directory = browser.pids(), browser.directory
    browser.end()
    assert [pid for pid in pids if alive(pid)] == []
    assert not directory.exists()
