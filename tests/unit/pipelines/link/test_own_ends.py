"""The socket of a path to another machine."""

import socket

import pytest
from common import eventually

from pipelines.link import own_ends
from pipelines.link.own_ends import PeerPlan, PeerSocket
from pipelines.session.setup.segments import Segment
from telepresence.link.frame import FrameCodec
from telepresence.link.peer_path import FIRST_LOOKUP_NS, OpenPath
from telepresence.link.profile import DOWNLINK

FRAME = FrameCodec(DOWNLINK).pack_idle(7, None)


def opened(bind, peer=None, host=None, clock_ns=lambda: 0):
    plan = PeerPlan(segment=Segment.GROUND, bind=(bind, 0), peer=peer, host=host, protection=None)
    return PeerSocket(OpenPath(DOWNLINK, address=peer, now_ns=0), plan, clock_ns)


@pytest.mark.parametrize(("bind", "host"), [("::1", "::1"), ("::", "127.0.0.1")])
def test_frames_go_by_ipv6_and_to_a_listener_of_both_versions(bind, host):
    listener = opened(bind)
    caller = opened(host, (host, listener.udp.getsockname()[1]))
    for sender, receiver in ((caller, listener), (listener, caller)):
        sender.send(FRAME)
        eventually(lambda there=receiver: there.frame() == FRAME)
    assert ":" in listener.report().address


def test_a_silent_peers_name_is_looked_up_beside_the_loop(monkeypatch):
    now_ns, looked_up = [0], [(socket.AF_INET, socket.SOCK_DGRAM, 0, "", ("192.0.2.7", 27000))]
    monkeypatch.setattr(own_ends.socket, "getaddrinfo", lambda *asked: looked_up)
    end = opened("127.0.0.1", ("192.0.2.1", 27000), "space.example", lambda: now_ns[0])
    assert end.report().address == "192.0.2.1:27000"
    now_ns[0] = FIRST_LOOKUP_NS
    eventually(lambda: end.report().address == "192.0.2.7:27000")
