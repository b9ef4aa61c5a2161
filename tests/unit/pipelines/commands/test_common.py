"""Which session a command acts on, and when it asks."""

import pytest

from kontur_av.errors import ConfigError
from pipelines.commands import common
from pipelines.commands.common import acting_on, sending_end
from pipelines.mission.tmtc_socket import tmtc_socket_name
from pipelines.session.setup.segments import Segment

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


@pytest.mark.parametrize(
    ("ends", "asked", "sender", "meant"),
    [
        ({LAB: "space ground"}, None, None, (LAB, Segment.SPACE)),
        # A ground machine of its own.
        ({LAB: "ground"}, None, None, (LAB, Segment.GROUND)),
        ({LAB: "ground"}, "lab", None, (LAB, Segment.GROUND)),
        ({LAB: "ground", SEA: "space"}, LAB, None, (LAB, Segment.GROUND)),
        ({LAB: "ground", SEA: "space"}, SEA, None, (SEA, Segment.SPACE)),
        ({LAB: "ground"}, LAB, "space", "lab-1 runs here without its end space"),
        ({}, None, None, "no session is running"),
    ],
)
def test_a_session_is_found_whichever_of_its_ends_is_here(monkeypatch, ends, asked, sender, meant):
    def running(socket):
        ends_of = {tmtc_socket_name(end): end.value for end in Segment}
        return [name for name, told in ends.items() if ends_of[socket] in told.split()]

    monkeypatch.setattr(common, "running_sessions", running)
    monkeypatch.setattr(common, "launched_sessions", lambda: list(ends))
    monkeypatch.setattr(common, "started_here", lambda session: False)
    if isinstance(meant, tuple):
        assert sending_end(asked, Segment.GROUND, sender) == meant
        return
    with pytest.raises(ConfigError, match=meant):
        sending_end(asked, Segment.GROUND, sender)
