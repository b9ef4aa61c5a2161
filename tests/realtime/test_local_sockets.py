"""Sockets of this machine: whose datagrams are accepted, and which session a question reaches."""

import socket
import tempfile
import threading
from contextlib import closing

import msgspec
import pytest
from common import TIMEOUT_S

from kontur_av.errors import ConfigError
from pipelines.session import datagrams, terminals
from pipelines.session.sessions import hold_session
from pipelines.session.terminals import request_socket, running_sessions, send_request

DESK = "trainer"


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


@pytest.fixture
def here(sockets):
    """An address with a free port."""
    with sockets() as probe:
        return probe.getsockname()


def test_strangers_are_counted_and_displace_no_frame_of_the_peer(sockets, here):
    peer, unknown, neighbour = sockets(), sockets(), sockets("127.0.0.2")
    ours, unknown_senders = datagrams.open_peer(here, peer.getsockname())
    with closing(ours), closing(unknown_senders):
        for number in range(5000):
            unknown.sendto(bytes(500), here)
            if number % 100 == 0:
                peer.sendto(b"frame %d" % (number // 100), here)
        neighbour.sendto(b"x", here)
        # Datagrams of unknown senders fill no queue of the peer.
        frames = [datagrams.receive(ours, 100) for _ in range(51)]
        assert frames == [b"frame %d" % number for number in range(50)] + [None]
        assert datagrams.receive(unknown_senders, 1) == b"\0"
        ours.send(b"answer")
        assert peer.recvfrom(100) == (b"answer", here)
        with pytest.raises(OSError):
            sockets(*here)


def test_a_port_for_one_sender_takes_nobody_elses_datagrams(sockets, here):
    sender, unknown = sockets("127.0.0.2"), sockets()
    with datagrams.listen_to(here, sender.getsockname()) as udp:
        for _ in range(1000):
            unknown.sendto(bytes(500), here)
        sender.sendto(b"ours", here)
        assert [datagrams.receive(udp, 10), datagrams.receive(udp, 10)] == [b"ours", None]


def test_a_port_accepts_only_the_host_of_the_programs(sockets):
    # On loopback every program of this machine is accepted.
    for host, taken, refused in (
        ("127.0.0.3", [None, b"a pro", b"", None], 1),
        ("127.0.0.1", [b"a str", b"a pro", b"", None], 0),
    ):
        inlet = datagrams.Inlet(("127.0.0.1", 0), host)
        with closing(inlet.udp):
            for address, data in (("4", b"a unknown sender"), ("3", b"a program"), ("3", b"")):
                sockets(f"127.0.0.{address}").sendto(data, inlet.udp.getsockname())
            assert [inlet.receive(5) for _ in range(4)] == taken
            assert inlet.unknown_senders == refused
    assert (
        datagrams.is_loopback("127.0.0.1")
        and datagrams.is_loopback("127.9.9.9")
        and not datagrams.is_loopback("128.0.0.1")
    )
    assert datagrams.reaches(("127.0.0.5", 9)) == "127.0.0.1"


def test_a_missing_listener_is_no_fault(sockets, here):
    to_nobody = datagrams.outlet("127.0.0.1", here)
    for _ in range(5):
        to_nobody.send(b"anybody?")
    back = sockets(*here)
    back.setblocking(False)
    to_nobody.send(b"1")
    to_nobody.send(b"2")
    assert [back.recv(9), back.recv(9)] == [b"1", b"2"]


@pytest.fixture
def directory(monkeypatch):
    """Not tmp_path, because the path of a socket must be short."""
    with tempfile.TemporaryDirectory(prefix="kav") as path:
        monkeypatch.setenv("TMPDIR", path)
        monkeypatch.setattr(terminals, "_TIMEOUT_S", TIMEOUT_S)
        yield path


@pytest.mark.usefixtures("directory")
def test_a_sessions_own_socket_belongs_to_one_process_and_samples_reach_it_in_any_life():
    first = datagrams.listen_alone("lab", 27_008)
    assert first is not None and datagrams.listen_alone("lab", 27_008) is None
    first.close()
    second = datagrams.listen_alone("lab", 27_008)
    assert second is not None
    second.close()
    to_robot = datagrams.OwnOutlet("lab", 27_009)
    to_robot.send(b"too soon")
    for boot_id in (b"first", b"second"):
        with datagrams.listen_own("lab", 27_009) as robot:
            to_robot.send(boot_id)
            assert datagrams.receive(robot) == boot_id
        to_robot.send(b"nobody listens")
    assert to_robot.failed == 3


class Line(msgspec.Struct):
    text: str = "ask"


@pytest.fixture
def service(directory):
    """desk(session, answer): a listening socket; returns the lines that it received."""
    listeners = []

    def listen(session, answer=b'{"text": "done"}\n'):
        path = request_socket(session, DESK)
        path.parent.parent.mkdir(mode=0o700, exist_ok=True)
        path.parent.mkdir()
        listener = socket.socket(socket.AF_UNIX)
        listener.bind(str(path))
        listener.listen()
        listeners.append(listener)
        asked = []

        def run():
            while True:
                try:
                    link, _ = listener.accept()
                except OSError:
                    return
                with link:
                    link.settimeout(TIMEOUT_S)
                    line = link.makefile("rb").readline()
                    if line:
                        asked.append(line)
                        link.sendall(answer)

        threading.Thread(target=run, daemon=True).start()
        return asked

    yield listen
    for listener in listeners:
        listener.shutdown(socket.SHUT_RDWR)
        listener.close()


def ask(session=None, name=DESK):
    return send_request(name, Line(), Line, session, missing="nobody trains here")


def test_the_only_session_is_asked_and_one_that_dies_answers_nothing(service):
    asked = service("taskboard-41")
    assert ask() == Line("done")
    assert asked == [b'{"text":"ask"}\n']
    with pytest.raises(ConfigError, match="nobody trains here"):
        ask(name="owner")
    service("spacejustin-42", b"")
    # The setup's name selects its only session.
    assert ask("taskboard") == Line("done")
    assert ask("spacejustin") is None


def test_with_several_sessions_a_name_is_required(service):
    service("taskboard-41")
    service("taskboard-42", b'{"text": "second"}\n')
    assert sorted(running_sessions(DESK)) == ["taskboard-41", "taskboard-42"]
    several = r"several .* taskboard-41, taskboard-42 with --session"
    for session, says in (
        ("lab", r"no session lab is running: .*taskboard-42"),
        ("taskboard", several),
        (None, several),
    ):
        with pytest.raises(ConfigError, match=says):
            ask(session)
    assert ask("taskboard-42") == Line("second")


@pytest.mark.parametrize("kind", [socket.SOCK_STREAM, socket.SOCK_DGRAM])
def test_a_killed_session_is_ignored_and_sockets_of_datagrams_are_found(service, kind):
    service("one")
    request_socket("dead", DESK).parent.mkdir(parents=True)
    with socket.socket(socket.AF_UNIX, kind) as dead:
        dead.bind(str(request_socket("dead", DESK)))
    assert running_sessions(DESK) == ["one"]
    assert ask() == Line("done")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as link:
        link.bind(str(request_socket("one", "tmtc.space")))
        assert running_sessions("tmtc.space") == ["one"]


def test_a_process_that_is_restarted_is_waited_for(service):
    service("other", b"")
    with hold_session("lab") as session:
        path = request_socket(session, DESK)
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as killed:
            killed.bind(str(path))
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as again:

            def restart():
                path.unlink()
                again.bind(str(path))
                again.listen()

            restarting = threading.Timer(0.2, restart)
            restarting.start()
            assert session in running_sessions(DESK)
            restarting.join()
