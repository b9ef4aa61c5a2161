"""Fixtures that start sessions, or have topics or keys without one."""

import contextlib
import secrets
from pathlib import Path

import pytest

pytest.register_assert_rewrite("running_session")

from running_session import RunningSession  # noqa: E402

from kontur_av.topics.session_files import remove_session, shared_memory  # noqa: E402
from pipelines.link.key_files import make_key, trust  # noqa: E402


@pytest.fixture
def start(tmp_path):
    """start("taskboard", *options): a running session, which ends after the test in any case."""
    with contextlib.ExitStack() as started:

        def start_session(setup, *options, prefix=()):
            session = RunningSession(setup, *options, directory=tmp_path, prefix=prefix)
            return started.enter_context(session)

        yield start_session


@pytest.fixture(params=["iceoryx2", "files"])
def session(request, monkeypatch):
    """The name of a session of topics alone, of each kind; it leaves nothing behind."""
    if request.param == "files":
        monkeypatch.setenv("KONTUR_AV_TOPICS", "files")
    name = f"test-{secrets.token_hex(4)}"
    yield name
    remove_session(name)
    assert not shared_memory(name)


@pytest.fixture
def keys(tmp_path):
    """The key files of ground and space, which trust each other."""
    paths = {name: tmp_path / f"{name}.pem" for name in ("ground", "space")}
    identities = {name: make_key(path).identity for name, path in paths.items()}
    trust(paths["ground"], identities["space"])
    trust(paths["space"], identities["ground"])
    return paths


def pytest_collection_modifyitems(items):
    """Mark all tests here as realtime, because they start processes or sleep."""
    for item in items:
        if item.path.is_relative_to(Path(__file__).parent):
            item.add_marker(pytest.mark.realtime)
