"""A session knows its terminal."""

import os

from pipelines.session.sessions import hold_session, started_here


def test_a_session_knows_its_terminal(tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    with hold_session("lab") as session:
        assert started_here(session)
        monkeypatch.setattr(os, "getsid", lambda _: 1)
        assert not started_here(session)
    assert not started_here(session)
