"""Which session a command acts on, and when it asks."""

import pytest

from kontur_av.errors import ConfigError
from pipelines.commands import common
from pipelines.commands.common import acting_on

LAB, SEA = "lab-1", "sea-2"


@pytest.mark.parametrize(
    ("everywhere", "here", "asked", "able", "moves", "meant"),
    [
        ([LAB], [], None, [LAB], True, LAB),
        # Of several the one of this terminal is meant.
        ([LAB, SEA], [SEA], None, [LAB, SEA], True, SEA),
        ([LAB, SEA], [SEA], LAB, [LAB, SEA], True, LAB),
        ([LAB, SEA], [LAB, SEA], None, [LAB, SEA], False, "several sessions"),
        # Only one has what the command needs, which is no reason to take it for the meant one.
        ([LAB, SEA], [], None, [LAB], False, LAB),
        ([LAB, SEA], [], None, [LAB], True, "sea-2 runs, too: name it with --session lab-1"),
        ([LAB, SEA], [], "lab", [LAB], True, LAB),
        ([LAB, SEA], [], None, [], True, "no session"),
    ],
)
def test_what_moves_a_robot_asks_when_another_session_may_be_meant(
    monkeypatch, capsys, everywhere, here, asked, able, moves, meant
):
    monkeypatch.setattr(common, "launched_sessions", lambda: everywhere)
    monkeypatch.setattr(common, "started_here", lambda session: session in here)
    if meant in everywhere:
        assert acting_on(asked, able, moves=moves) == meant
        if moves:
            assert capsys.readouterr().err == f"session {meant}\n"
        return
    with pytest.raises(ConfigError, match=meant):
        acting_on(asked, able, moves=moves)
