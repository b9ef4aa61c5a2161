"""What each process of a session stands on: figures that are not lost, datagrams that go out."""

import socket

import pytest

from kontur_av.clock import MonotonicClock
from pipelines.runtime.probe import Message, Probe
from pipelines.runtime.process import LOOPBACK, Context


@pytest.fixture
def link():
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    ours.setblocking(False)
    with ours, theirs:
        yield ours, theirs


def test_rows_go_once_and_are_collected_into_the_same_object(link):
    ours, theirs = link
    probe = Probe(theirs)
    rows = probe.rows("lateness")
    rows.append(7)
    probe.row("rx", 1, 2)
    probe.total("cycles", 1)
    probe.gauge("state", "well")
    probe.flush(0)
    first = Message.unpack(ours.recv(1 << 20))
    assert {name: list(values) for name, values in first.series.items()} == {
        "lateness": [7],
        "rx": [1, 2],
    }
    rows.append(8)
    probe.flush(1)
    second = Message.unpack(ours.recv(1 << 20))
    assert {name: list(values) for name, values in second.series.items()} == {"lateness": [8]}
    assert second.totals == {"cycles": 1}
    assert second.gauges == {}


def test_what_a_full_link_refuses_is_kept_for_the_next_time(link):
    ours, theirs = link
    probe = Probe(theirs)
    theirs.setblocking(False)
    with pytest.raises(BlockingIOError):
        while True:
            theirs.send(b"full")
    probe.rows("lateness").append(7)
    probe.gauge("state", "well")
    probe.flush(0)
    with pytest.raises(BlockingIOError):
        while True:
            ours.recv(1 << 20)
    probe.rows("lateness").append(8)
    probe.flush(1)
    message = Message.unpack(ours.recv(1 << 20))
    assert list(message.series["lateness"]) == [7, 8]
    assert message.gauges == {"state": "well"}


def test_a_sender_outlives_its_receiver_and_reaches_the_next_one():
    context = Context("test", None, MonotonicClock(), Probe(None))
    first = context.listen(0)
    port = first.getsockname()[1]
    send = context.sender(port)
    send(b"1")
    assert context.receive(first) == b"1"
    first.close()
    for _ in range(3):
        send(b"nobody hears this")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as second:
        second.setblocking(False)
        second.bind((LOOPBACK, port))
        send(b"2")
        send(b"and longer")
        assert context.receive(second) == b"2"
        assert context.receive(second, 3) == b"and"
        assert context.receive(second) is None
