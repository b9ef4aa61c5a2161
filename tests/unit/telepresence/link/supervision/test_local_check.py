"""The check of one end by itself: its own frames, and whether they leave the machine."""

import pytest

from pipelines.session.setup.segments import Direction
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.table import topology_of
from telepresence.link.receiver import LinkReceiver
from telepresence.link.sender import LinkSender
from telepresence.link.supervision.local_check import LocalCheck, self_test

MS = 1_000_000


@pytest.mark.parametrize("direction", Direction)
@pytest.mark.parametrize("setup", BUILT_IN.values(), ids=BUILT_IN)
def test_every_setup_passes_its_self_test(setup, direction):
    topology = topology_of(setup)
    assert self_test(topology.link(direction).profile, topology.flows(direction)) is None


@pytest.mark.parametrize(
    ("part", "name", "broken", "words"),
    [
        (LinkSender, "handle_packet", lambda *_: False, "refuses a packet"),
        (LinkReceiver, "handle_frame", lambda *_: False, "own frames"),
        (LinkSender, "handle_haptic", lambda *_: False, "a sample does not come through"),
        (LinkSender, "handle_packet", lambda *_: True, "does not come through"),
    ],
)
def test_what_is_broken_is_named(part, name, broken, words, monkeypatch):
    topology = topology_of(BUILT_IN["taskboard"])
    link = topology.link(Direction.UPLINK)
    monkeypatch.setattr(part, name, broken)
    assert words in self_test(link.profile, topology.flows(Direction.UPLINK))


@pytest.mark.parametrize("known", [None, "self-test: broken"])
def test_frames_that_the_system_refuses_for_200_ms_are_a_fault(known):
    check = LocalCheck(known, 0)
    for ms in range(1, 200):
        check.handle_frames(ms, ms, "no route", ms * MS)
        assert check.fault == known
    check.handle_frames(200, 200, "no route", 200 * MS)
    fault = known or "this machine does not send the frames: no route"
    assert check.fault == fault
    # Without frames nothing is known anew; one that leaves ends it, and the time begins again.
    check.handle_frames(200, 200, "no route", 900 * MS)
    assert check.fault == fault
    check.handle_frames(202, 201, "no route", 901 * MS)
    assert check.fault == known
    check.handle_frames(203, 202, "no route", 1100 * MS)
    assert check.fault == known
    check.handle_frames(204, 203, "again", 1101 * MS)
    assert check.fault == (known or "this machine does not send the frames: again")
