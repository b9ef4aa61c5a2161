"""Sessions for the tests that need one."""

import pytest

pytest.register_assert_rewrite("running_session")

from running_session import RunningSession  # noqa: E402


@pytest.fixture
def start(tmp_path):
    """start("taskboard", *options): the session, running; ended after the test in any case."""
    started = []

    def start_session(setup, *options):
        started.append(RunningSession(setup, *options, directory=tmp_path))
        return started[-1]

    yield start_session
    for session in started:
        session.__exit__()
