"""How a live session ends for its user."""

from types import SimpleNamespace

from pipelines.commands import live_session
from pipelines.session.options import StreamOptions


def test_a_quiet_session_says_what_failed(capsys, monkeypatch):
    failed = SimpleNamespace(failures=["why"])
    monkeypatch.setattr(live_session, "session_report", lambda *_: failed)
    collector = SimpleNamespace(handle_end=lambda: None, trace=None)
    assert live_session.end_session(StreamOptions(quiet=True), collector, None) == 1
    assert capsys.readouterr() == ("", "failed: why\n")
