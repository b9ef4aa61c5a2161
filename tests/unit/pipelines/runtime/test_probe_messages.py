"""Figures travel from a process to the launcher in whole rows, and never delay the process."""

import socket

import pytest

from pipelines.runtime.probe import FLUSH_NS, Message, Probe


@pytest.fixture
def ends():
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    ours.setblocking(False)
    with ours, theirs:
        yield ours, theirs


def received(link):
    return Message.unpack(link.recv(1 << 22))


def test_totals_are_repeated_and_rows_are_sent_once(ends):
    launcher, process = ends
    probe = Probe(process)
    probe.total("sent", 4)
    probe.gauge("state", "well")
    probe.row("tx", 1, 2, -3)
    probe.flush(0)
    message = received(launcher)
    assert (message.totals, message.gauges) == ({"sent": 4}, {"state": "well"})
    assert list(message.series["tx"]) == [1, 2, -3]
    probe.row("tx", 7, 8, 9)
    probe.flush(1)
    message = received(launcher)
    assert message.totals == {"sent": 4}
    assert list(message.series["tx"]) == [7, 8, 9]


def test_it_is_due_twice_a_second(ends):
    probe = Probe(ends[1])
    assert probe.due(0)
    probe.flush(0)
    assert not probe.due(FLUSH_NS - 1)
    assert probe.due(FLUSH_NS)


def test_a_launcher_that_does_not_read_delays_nothing_and_loses_whole_rows(ends):
    launcher, process = ends
    process.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 17)
    probe = Probe(process)
    for number in range(60_000):
        probe.row("rx", number, -number)
        if number % 500 == 499:
            probe.total("rows", number + 1)
            probe.flush(number)
    seen = []
    with pytest.raises(BlockingIOError):
        while True:
            seen += list(received(launcher).series.get("rx", ()))
    probe.flush(60_000)
    message = received(launcher)
    seen += list(message.series.get("rx", ()))
    assert message.totals["rows"] == 60_000
    # A row arrives whole or not at all, and every missing one is counted.
    assert all(right == -left for left, right in zip(seen[::2], seen[1::2], strict=True))
    assert 0 < message.totals["probe_values_dropped"] == 2 * 60_000 - len(seen)


def test_a_closed_launcher_is_no_error(ends):
    launcher, process = ends
    launcher.close()
    probe = Probe(process)
    probe.row("rx", 1)
    probe.flush(0)
    Probe(None).flush(0)
