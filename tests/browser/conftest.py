"""Fixtures that start browsers and sessions with pages."""

from pathlib import Path

import pytest

pytest.register_assert_rewrite("browser", "running_session")

import browser as browsers  # noqa: E402

ROOM = Path(__file__).parent


def pytest_collection_modifyitems(items):
    """Mark all tests here: they need a browser, and they start processes."""
    lacking = browsers.missing()
    for item in items:
        if item.path.is_relative_to(ROOM):
            item.add_marker(pytest.mark.browser)
            item.add_marker(pytest.mark.realtime)
            if lacking is not None:
                item.add_marker(pytest.mark.skip(reason=lacking))


@pytest.fixture
def start_browser():
    """start_browser(camera=..., ...): a running browser, which ends after the test in any case."""
    started = []

    def start(**options):
        started.append(browsers.Browser(**options))
        return started[-1]

    yield start
    for one in started:
        one.end()
