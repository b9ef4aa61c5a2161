"""The check of one end by itself: its own frames, and whether they leave the machine."""

import pytest

from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.session.topology import Direction
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


def test_frames_that_the_system_refuses_are_a_fault_until_one_leaves():
    check = LocalCheck(None, 0)
    check.handle_frames(100, 40, "full", 100 * MS)
    check.handle_frames(200, 140, "Network is unreachable", 200 * MS)
    assert check.fault is None
    check.handle_frames(300, 240, "Network is unreachable", 300 * MS)
    assert check.fault == "this machine does not send the frames: Network is unreachable"
    check.handle_frames(300, 240, "Network is unreachable", 400 * MS)
    assert check.fault
    check.handle_frames(400, 339, "Network is unreachable", 500 * MS)
    assert check.fault is None


def test_a_failed_self_test_stays():
    check = LocalCheck("self-test: voice", 0)
    check.handle_frames(100, 0, "", 100 * MS)
    assert check.fault == "self-test: voice"
