"""The ends of a process: no figures are lost, and datagrams go out."""

import socket

import pytest

from kontur_av.clock import MonotonicClock
from pipelines.session.probe import FLUSH_NS, Message
from pipelines.session.process import Context
from pipelines.session.session_metrics import LatenessRow, LoopMetrics, ProbeMetrics, RxRow
from telepresence.haptics.haptic_metrics import PortMetrics


@pytest.fixture
def link():
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    ours.setblocking(False)
    with ours, theirs:
        yield ours, theirs


def context_of(link):
    return Context("test", None, MonotonicClock(), link=link)


def received(link):
    return Message.unpack(link.recv(1 << 22))


def test_metrics_are_filled_in_and_sent_when_they_are_due_also_after_a_full_socket(link):
    ours, theirs = link
    context = context_of(theirs)
    context.on_flush(lambda: context.probe.series(LatenessRow).add(LatenessRow(7)))
    context.tick(0)
    context.tick(FLUSH_NS - 1)
    (series,) = received(ours).series
    assert series.rows() == [LatenessRow(7)]
    with pytest.raises(BlockingIOError):
        received(ours)
    theirs.setblocking(False)
    with pytest.raises(BlockingIOError):
        while True:
            theirs.send(b"full")
    context.probe.publish(PortMetrics(credit_uj=1, least_uj=0))
    context.tick(FLUSH_NS)
    with pytest.raises(BlockingIOError):
        while True:
            ours.recv(1 << 20)
    context.tick(2 * FLUSH_NS)
    message = received(ours)
    assert message.series[0].rows() == [LatenessRow(7)] * 2
    assert message.metrics[PortMetrics, ""].credit_uj == 1


def test_a_launcher_that_does_not_read_delays_nothing_and_loses_whole_rows(link):
    ours, theirs = link
    theirs.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 17)
    context = context_of(theirs)
    arrivals = context.probe.series(RxRow)
    for number in range(60_000):
        arrivals.add(RxRow(number, -number))
        if number % 500 == 499:
            context.probe.publish(LoopMetrics(cycles=number + 1))
            context.send_metrics(number)
    seen = []
    with pytest.raises(BlockingIOError):
        while True:
            seen += [row for series in received(ours).series for row in series.rows()]
    context.send_metrics(60_000)
    message = received(ours)
    seen += [row for series in message.series for row in series.rows()]
    assert message.metrics[LoopMetrics, ""].cycles == 60_000
    # A row arrives whole or not at all, and every missing one is counted.
    assert all(row.received_ns == -row.timestamp for row in seen)
    dropped = message.metrics[ProbeMetrics, ""].probe_values_dropped
    assert 0 < dropped == 2 * (60_000 - len(seen))


def test_a_closed_launcher_is_no_error(link):
    ours, theirs = link
    ours.close()
    for end in (theirs, None):
        context_of(end).send_metrics(0)
