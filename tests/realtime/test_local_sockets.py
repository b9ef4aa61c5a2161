"""Sockets of this machine: whose datagrams are accepted, and how a process is asked."""

import asyncio
import socket
import tempfile
import threading
from contextlib import ExitStack, closing
from types import SimpleNamespace

import msgspec
import pytest
from common import TIMEOUT_S

from kontur_av.clock import NS_PER_MS
from kontur_av.errors import ConfigError
from pipelines.session import datagrams, requests
from pipelines.session.probe import Probe
from pipelines.session.requests import request_socket, running_sessions
from pipelines.session.sessions import hold_session

SERVICE = "trainer"


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
        ("127.0.0.1", [b"unkno", b"a pro", b"", None], 0),
    ):
        inlet = datagrams.Inlet(("127.0.0.1", 0), host)
        with closing(inlet.udp):
            for address, data in (("4", b"unknown sender"), ("3", b"a program"), ("3", b"")):
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
        monkeypatch.setattr(requests, "_TIMEOUT_S", TIMEOUT_S)
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


class Question(msgspec.Struct, tag=True):
    number: int = 1


class Pause(msgspec.Struct, tag=True):
    """Answered never."""


class Reply(msgspec.Struct, frozen=True, tag=True):
    text: str


@pytest.fixture
def service(directory):
    """service(session, text): a process that answers `text`; returns its server."""
    with ExitStack() as stack:

        def answer(request, text):
            if isinstance(request, Pause):
                return None
            if request.number < 0:
                raise ConfigError("take a number above 0")
            return Reply(text)

        def begin(session, text="done"):
            process = SimpleNamespace(session=session, probe=Probe(), on_flush=lambda _fill: None)
            take = lambda request, _: answer(request, text)  # noqa: E731
            server = requests.RequestServer(process, SERVICE, Question | Pause, take)
            ended = threading.Event()

            def run():
                while not ended.is_set():
                    server.serve(NS_PER_MS)
                server.close()

            thread = threading.Thread(target=run)
            thread.start()
            server.end = lambda: (ended.set(), thread.join())
            stack.callback(server.end)
            return server

        yield begin


def ask(session="lab-1", request=None, **more):
    return requests.ask(session, SERVICE, request or Question(), Reply, **more)


def ask_async(request=None, **more):
    """As an event loop asks."""
    asked = requests.ask_async("lab-1", SERVICE, request or Question(), Reply, **more)
    return asyncio.run(asked)


def test_a_slow_process_is_told_from_one_that_has_gone_and_from_one_that_refuses(service):
    for one in (ask, ask_async):
        with pytest.raises(ConnectionError, match="trainer is not running"):
            one()
    server = service("lab-1")
    for one in (ask, ask_async):
        assert one() == Reply("done")
        with pytest.raises(ConfigError, match="take a number above 0"):
            one(request=Question(-1))
        with pytest.raises(TimeoutError, match=r"trainer has not answered for 0\.1 s"):
            one(request=Pause(), timeout_s=0.1)
    with requests.RequestClient("lab-1", SERVICE) as client:
        assert [client.ask(Question(), Reply) for _ in range(3)] == [Reply("done")] * 3
        server.end()
        with pytest.raises(ConnectionError, match="trainer has ended before it answered"):
            client.ask(Question(), Reply)
    restarting = threading.Timer(0.2, service, ["lab-1", "again"])
    restarting.start()
    assert ask(return_s=TIMEOUT_S) == Reply("again")
    restarting.join()


def test_garbage_and_a_crowd_are_refused_and_end_nothing(service):
    server = service("lab-1")
    garbage = (b"\xc1", b"\x81" * 5000, bytes(requests.MAX_MESSAGE_OCTETS + 9), b"[[[[")
    with ExitStack() as stack:
        for octets in garbage:
            with requests.RequestClient("lab-1", SERVICE) as client:
                client._link.send(octets)
                refusal = msgspec.msgpack.decode(client._link.recv(9999))
                assert refusal["type"] == "RequestRefused" and "request" in refusal["text"]
                # The connection is still good.
                assert client.ask(Question(), Reply) == Reply("done")
        assert server._refused == len(garbage)
        assert requests.post("lab-1", SERVICE, b"")
        kept = stack.enter_context(requests.RequestClient("lab-1", SERVICE))
        for _ in range(3 * requests.MOST_CONNECTIONS):
            stack.enter_context(requests.RequestClient("lab-1", SERVICE))
            # Who asks is not the one that is closed.
            assert kept.ask(Question(), Reply) == Reply("done")
        # A client that reads no answers is closed.
        deaf = stack.enter_context(requests.RequestClient("lab-1", SERVICE))
        with pytest.raises(ConnectionError):
            while True:
                deaf._link.send(msgspec.msgpack.encode(Question()))
    assert ask() == Reply("done")


def test_only_running_sessions_are_found(service):
    for name in ("lab-1", "lab-2"):
        service(name)
    request_socket("dead", SERVICE).parent.mkdir(parents=True)
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as dead:
        dead.bind(str(request_socket("dead", SERVICE)))
    assert sorted(running_sessions(SERVICE)) == ["lab-1", "lab-2"]
    assert running_sessions("arm") == []
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as more:
        more.bind(str(request_socket("lab-2", "arm")))
        assert sorted(running_sessions(SERVICE, "arm")) == ["lab-1", "lab-2"]


def test_a_process_that_is_restarted_is_waited_for(service):
    service("other")
    with hold_session("lab") as session:
        path = request_socket(session, SERVICE)
        with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as killed:
            killed.bind(str(path))
        restarting = threading.Timer(0.2, service, [session])
        restarting.start()
        assert session in running_sessions(SERVICE)
        restarting.join()
