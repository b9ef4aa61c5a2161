"""A session knows its terminal, and its files wait for no disk."""

import os

from kontur_av.topics.session_files import SHARED_MEMORY, session_root
from pipelines.session.sessions import hold_session, started_here


def test_a_session_knows_its_terminal(tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    with hold_session("lab") as session:
        assert started_here(session)
        monkeypatch.setattr(os, "getsid", lambda _: 1)
        assert not started_here(session)
    assert not started_here(session)


def test_files_that_processes_in_real_time_write_are_on_no_disk(monkeypatch):
    for name in ("TMPDIR", "TEMP", "TMP"):
        monkeypatch.delenv(name, raising=False)
    assert session_root("lab").is_relative_to(SHARED_MEMORY)
