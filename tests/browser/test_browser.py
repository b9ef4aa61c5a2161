"""What the other tests here rely on: errors of pages are found, and a browser leaves nothing."""

import browser as browsers
import pytest
from running_session import alive

FAILS = """
    setTimeout(() => missing(), 0);
    const code = new Blob(["self.onmessage = () => { throw new Error('the worker fell'); }"]);
    new Worker(URL.createObjectURL(code)).postMessage(1);
"""


def test_an_error_that_nobody_caught_is_found_and_an_end_leaves_nothing():
    if (lacking := browsers.missing()) is not None:
        pytest.skip(lacking)
    with browsers.Browser() as browser:
        page = browser.open("data:text/html,<title>A page</title>")
        tab = browser.open("about:blank", "tab")
        assert tab.run("return document.visibilityState") == "visible"
        tab.close()
        browser.assert_no_errors()
        page.run(FAILS)
        found = browsers.eventually(lambda: len(browser.errors()) >= 2 and browser.errors(), "both")
        assert any("missing is not defined" in one for one in found)
        assert any("the worker fell" in one for one in found)
        with pytest.raises(AssertionError):
            browser.assert_no_errors()
        browser.begin_anew()
        browser.assert_no_errors()
        pids, directory = browser.pids(), browser.directory
    assert [pid for pid in pids if alive(pid)] == []
    assert not directory.exists()
