"""Sessions for the tests that need one."""

import pytest
from running_session import RunningSession


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
