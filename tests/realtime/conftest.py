"""Fixtures that start sessions."""

import contextlib
from pathlib import Path

import pytest

pytest.register_assert_rewrite("running_session")

from running_session import RunningSession  # noqa: E402


@pytest.fixture
def start(tmp_path):
    """start("taskboard", *options): a running session, which ends after the test in any case."""
    with contextlib.ExitStack() as started:

        def start_session(setup, *options, prefix=()):
            session = RunningSession(setup, *options, directory=tmp_path, prefix=prefix)
            return started.enter_context(session)

        yield start_session


def pytest_collection_modifyitems(items):
    """Mark all tests here as realtime, because they start processes or sleep."""
    for item in items:
        if item.path.is_relative_to(Path(__file__).parent):
            item.add_marker(pytest.mark.realtime)
