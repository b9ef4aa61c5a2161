"""The socket of a path to another machine."""

import socket

from common import eventually

from pipelines.link import own_ends
from pipelines.link.own_ends import PeerPlan, PeerSocket
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.session.topology import Segment
from telepresence.link.frame import FrameCodec
from telepresence.link.peer_path import FIRST_LOOKUP_NS, OpenPath

DOWNLINK = BUILT_IN["spacejustin"].downlink
FRAME = FrameCodec(DOWNLINK).pack_idle(7, None)


def opened(bind, peer=None, host=None, clock_ns=lambda: 0):
    plan = PeerPlan(segment=Segment.GROUND, bind=(bind, 0), peer=peer, host=host, protection=None)
    return PeerSocket(OpenPath(DOWNLINK, address=peer, now_ns=0), plan, clock_ns)


def test_frames_go_by_ipv6_and_to_a_listener_of_both_versions():
    for bind, peer in (("::1", "::1"), ("::", "127.0.0.1")):
        listener = opened(bind)
        port = listener.udp.getsockname()[1]
        caller = opened("::1" if ":" in peer else "127.0.0.1", (peer, port))
        caller.send(FRAME)
        eventually(lambda there=listener: there.frame() == FRAME)
        listener.send(FRAME)
        eventually(lambda here=caller: here.frame() == FRAME)
        assert ":" in listener.report().address
        for end in (listener, caller):
            end.udp.close()


def test_a_silent_peers_name_is_looked_up_beside_the_loop(monkeypatch):
    now_ns, asked = [0], []

    def getaddrinfo(*args):
        asked.append(args)
        return [(socket.AF_INET, socket.SOCK_DGRAM, 0, "", ("192.0.2.7", args[1]))]

    monkeypatch.setattr(own_ends.socket, "getaddrinfo", getaddrinfo)
    end = opened("127.0.0.1", ("192.0.2.1", 27000), "space.example", lambda: now_ns[0])
    assert end.report().address == "192.0.2.1:27000" and not asked
    now_ns[0] = FIRST_LOOKUP_NS
    eventually(lambda: end.report().address == "192.0.2.7:27000")
    assert asked == [("space.example", 27000, socket.AF_INET, socket.SOCK_DGRAM)]
    end.udp.close()
