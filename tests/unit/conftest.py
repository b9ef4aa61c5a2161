"""Unit tests start no process and run no session."""

from pathlib import Path

import pytest
from unit_room import closed_doors


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item):
    """A hook, because a module's fixture would run before a fixture that closes the doors."""
    if not item.path.is_relative_to(Path(__file__).parent):
        return (yield)
    with closed_doors():
        return (yield)
