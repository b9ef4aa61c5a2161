"""A path without protection: whose frames are followed."""

import pytest

from pipelines.session.setup.setup_file import BUILT_IN
from telepresence.link.frame import FrameCodec
from telepresence.link.peer_path import SILENCE_NS, OpenPath

DOWNLINK = BUILT_IN["spacejustin"].downlink
GOOD = FrameCodec(DOWNLINK).pack_idle(7, None)
HIT = bytes([GOOD[0] ^ 1]) + GOOD[1:]
PEER, OTHER = ("192.0.2.1", 27000), ("192.0.2.9", 4000)


@pytest.fixture
def waiting():
    return OpenPath(DOWNLINK, address=None, now_ns=0)


def test_who_sends_a_good_frame_first_is_the_peer(waiting):
    assert waiting.seal(b"frame", 0) is None
    assert waiting.handle_datagram(HIT, OTHER, 1) is None
    assert waiting.handle_datagram(b"", OTHER, 1) is None
    assert waiting.handle_datagram(GOOD, PEER, 2) == GOOD
    assert waiting.seal(b"frame", 3) == (b"frame", PEER)
    figures = waiting.report(4)
    assert (figures.address, figures.session_ns, figures.unsent) == ("192.0.2.1:27000", 2, 1)
    assert figures.dropped == {"stranger": 2}
    assert not figures.protected


def test_another_is_followed_only_after_a_silence(waiting):
    waiting.handle_datagram(GOOD, PEER, 0)
    # A frame that the radio has hit is none the less a sign of life.
    assert waiting.handle_datagram(HIT, PEER, SILENCE_NS) == HIT
    assert waiting.handle_datagram(GOOD, OTHER, 2 * SILENCE_NS - 1) is None
    assert waiting.handle_datagram(HIT, OTHER, 2 * SILENCE_NS) is None
    assert waiting.handle_datagram(GOOD, OTHER, 2 * SILENCE_NS) == GOOD
    figures = waiting.report(2 * SILENCE_NS)
    assert (figures.address, figures.address_changes) == ("192.0.2.9:4000", 1)
    assert figures.dropped == {"stranger": 2}
    assert figures.events[-1].what == "peer moved to 192.0.2.9:4000"


def test_a_given_address_is_never_left():
    path = OpenPath(DOWNLINK, address=PEER, now_ns=0)
    assert path.handle_datagram(GOOD, OTHER, 9 * SILENCE_NS) is None
    assert path.seal(b"frame", 1) == (b"frame", PEER)
    assert path.handle_datagram(GOOD, PEER, 10 * SILENCE_NS) == GOOD
