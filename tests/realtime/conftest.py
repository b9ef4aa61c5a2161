"""Fixtures that start sessions."""

from pathlib import Path

import pytest

pytest.register_assert_rewrite("running_session")

from running_session import RunningSession  # noqa: E402


@pytest.fixture
def start(tmp_path):
    """start("taskboard", *options): a running session, which ends after the test in any case."""
    started = []

    def start_session(setup, *options, prefix=()):
        started.append(RunningSession(setup, *options, directory=tmp_path, prefix=prefix))
        return started[-1]

    yield start_session
    for session in started:
        session.__exit__()


def pytest_collection_modifyitems(items):
    """Mark all tests here as realtime, because they start processes or sleep."""
    for item in items:
        if item.path.is_relative_to(Path(__file__).parent):
            item.add_marker(pytest.mark.realtime)
