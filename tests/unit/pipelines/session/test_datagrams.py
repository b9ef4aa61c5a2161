"""A gateway accepts datagrams of its peer and its programs, and counts all others."""

import socket

import pytest

from pipelines.session.datagrams import (
    Inlet,
    OwnOutlet,
    is_loopback,
    listen_alone,
    listen_own,
    listen_to,
    open_peer,
    outlet,
    reaches,
    receive,
)


@pytest.fixture
def sockets():
    made = []

    def make(host="127.0.0.1", port=0):
        udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        made.append(udp)
        udp.bind((host, port))
        return udp

    yield make
    for udp in made:
        udp.close()


def test_strangers_are_counted_and_displace_no_frame_of_the_peer(sockets):
    peer, stranger, neighbour = sockets(), sockets(), sockets("127.0.0.2")
    probe = sockets()
    here = probe.getsockname()
    probe.close()
    ours, strangers = open_peer(here, peer.getsockname())
    try:
        for number in range(5000):
            stranger.sendto(bytes(500), here)
            if number % 100 == 0:
                peer.sendto(b"frame %d" % (number // 100), here)
        neighbour.sendto(b"x", here)
        # Datagrams of strangers fill no queue of the peer.
        frames = [receive(ours, 100) for _ in range(51)]
        assert frames == [b"frame %d" % number for number in range(50)] + [None]
        assert receive(strangers, 1) == b"\0"
        ours.send(b"answer")
        assert peer.recvfrom(100) == (b"answer", here)
        with pytest.raises(OSError):
            sockets(*here)
    finally:
        ours.close()
        strangers.close()


def test_a_port_for_one_sender_takes_nobody_elses_datagrams(sockets):
    sender, stranger, probe = sockets("127.0.0.2"), sockets(), sockets()
    here = probe.getsockname()
    probe.close()
    with listen_to(here, sender.getsockname()) as udp:
        for _ in range(1000):
            stranger.sendto(bytes(500), here)
        sender.sendto(b"ours", here)
        assert [receive(udp, 10), receive(udp, 10)] == [b"ours", None]


def test_one_process_has_a_sessions_own_socket_until_it_ends(tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    first = listen_alone("lab", 27_008)
    assert first is not None and listen_alone("lab", 27_008) is None
    first.close()
    second = listen_alone("lab", 27_008)
    assert second is not None
    second.close()


def test_a_port_accepts_only_the_host_of_the_programs(sockets):
    inlet = Inlet(("127.0.0.1", 0), "127.0.0.3")
    here = inlet.udp.getsockname()
    sockets("127.0.0.4").sendto(b"a stranger", here)
    sockets("127.0.0.3").sendto(b"a program", here)
    sockets("127.0.0.3").sendto(b"", here)
    assert [inlet.receive(100) for _ in range(4)] == [None, b"a program", b"", None]
    assert inlet.strangers == 1
    inlet.udp.close()
    # On loopback every program of this machine is accepted.
    home = Inlet(("127.0.0.1", 0), "127.0.0.1")
    sockets("127.0.0.4").sendto(b"of this machine", home.udp.getsockname())
    assert home.receive(7) == b"of this"
    assert home.strangers == 0
    home.udp.close()


def test_a_missing_listener_is_no_fault(sockets):
    gone = sockets()
    where = gone.getsockname()
    gone.close()
    to_nobody = outlet("127.0.0.1", where)
    for _ in range(5):
        to_nobody.send(b"anybody?")
    back = sockets(*where)
    back.setblocking(False)
    to_nobody.send(b"1")
    to_nobody.send(b"2")
    assert [back.recv(9), back.recv(9)] == [b"1", b"2"]
    # A frame that no datagram can hold is counted as not sent.
    to_nobody.send(bytes(70_000))
    assert to_nobody.failed == 1


def test_which_addresses_are_this_machines():
    assert is_loopback("127.0.0.1")
    assert is_loopback("127.9.9.9")
    assert not is_loopback("128.0.0.1")
    assert reaches(("127.0.0.5", 9)) == "127.0.0.1"


def test_samples_reach_a_listener_that_comes_late_and_one_that_was_restarted(tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    to_robot = OwnOutlet("lab", 27_008)
    to_robot.send(b"too soon")
    for life in (b"first", b"second"):
        with listen_own("lab", 27_008) as robot:
            to_robot.send(life)
            assert receive(robot) == life
        to_robot.send(b"nobody listens")
    assert to_robot.failed == 3
