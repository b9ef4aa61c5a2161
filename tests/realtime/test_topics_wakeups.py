"""Readers that wait for a topic are woken: under load, by dying writers, with one system call."""

import multiprocessing
import os
import select
from pathlib import Path

import pytest
from common import TIMEOUT_S, repeats

from kontur_av.errors import ConfigError
from kontur_av.media import CaptureStamp
from kontur_av.topics import notifier as notifier_module
from kontur_av.topics.bus import MAX_READERS, TopicBus
from kontur_av.topics.notifier import NotificationListener, Notifier, WaitSet
from kontur_av.topics.session_files import notifier_path

#: Far longer than any wake-up takes; one that comes later was lost.
LONG_NS = 20_000_000_000
#: Not forked from here: this process has had a bus, and a child would inherit its locks.
PROCESSES = multiprocessing.get_context("forkserver")
PROCESSES.set_forkserver_preload(["kontur_av.topics.bus"])


@pytest.fixture
def path(session):
    return notifier_path(session, "any")


@pytest.fixture
def start(session):
    """Start processes, and end them after the test."""
    running = []

    def start(work, *arguments):
        environment = dict(os.environ)
        process = PROCESSES.Process(
            target=_work_in, args=(environment, work, session, *arguments), daemon=True
        )
        process.start()
        running.append(process)
        return process

    yield start
    for process in running:
        process.kill()
        process.join()


def _work_in(environment, work, *arguments):
    os.environ.update(environment)
    work(*arguments)


def stamp(sequence):
    return CaptureStamp(0, sequence, "x")


def _acknowledge_each(session, publish, depth):
    """Wait right after each sample, just when the next one is published."""
    bus = TopicBus(session)
    reader = bus.reader("numbers", depth=depth)
    waiter = bus.waiter([reader]) if depth > 1 else None
    publish.send_bytes(b"ready")
    while waiter.wait(LONG_NS) if waiter else reader.wait(LONG_NS):
        while (lease := reader.next()) is not None:
            sequence = lease.octets()
            lease.release()
            publish.send_bytes(sequence)
    publish.send_bytes(b"not woken")


def test_no_wakeup_is_lost_in_thousands(session, start):
    ends = []
    for depth in (1, 4):
        told, publish = PROCESSES.Pipe(duplex=False)
        start(_acknowledge_each, publish, depth)
        ends.append(told)
    for told in ends:
        assert told.poll(TIMEOUT_S)
        assert told.recv_bytes() == b"ready"
    with TopicBus(session) as bus:
        writer = bus.writer("numbers", max_octets=8)
        for sequence in range(repeats(2000)):
            number = sequence.to_bytes(8)
            writer.publish_octets(number, stamp(sequence))
            for told in ends:
                assert told.poll(TIMEOUT_S), f"asleep since {sequence}"
                assert told.recv_bytes() == number


def _die_before_ringing(session, order):
    writer = TopicBus(session).writer("numbers", max_octets=8)
    writer.publish_octets(bytes(8), stamp(0))
    order.recv_bytes()
    Notifier.notify = lambda _: os.kill(os.getpid(), 9)
    writer.publish_octets(bytes(8), stamp(1))


def test_a_writer_killed_before_it_notifies_still_wakes_readers(session, start):
    order, give = PROCESSES.Pipe(duplex=False)
    with TopicBus(session) as bus:
        reader = bus.reader("numbers")
        waiter = bus.waiter([reader])
        start(_die_before_ringing, order)
        seen = None
        for wanted in (0, 1):
            while seen != wanted:
                assert waiter.wait(LONG_NS), "not woken"
                if (lease := reader.latest()) is not None:
                    with lease:
                        seen = lease.stamp.sequence
            while waiter.wait(0):
                pass
            if wanted == 0:
                give.send_bytes(b"now")


@pytest.mark.parametrize("readers", [0, 1, MAX_READERS])
def test_a_publication_takes_one_system_call_for_any_number_of_readers(
    session, monkeypatch, readers
):
    notified = []

    def write(fd, data):
        notified.append(fd)
        return real_write(fd, data)

    real_write = os.write
    monkeypatch.setattr(notifier_module.os, "write", write)
    with TopicBus(session) as bus:
        writer, silent = (bus.writer("numbers", max_octets=8, wake=wake) for wake in (True, False))
        waiters = [bus.waiter([bus.reader("numbers")]) for _ in range(readers)]
        for sequence in range(3):
            writer.publish_octets(bytes(8), stamp(sequence))
            assert len(notified) == sequence + 1
            assert [waiter.wait(LONG_NS) for waiter in waiters] == [True] * readers
            silent.publish_octets(bytes(8), stamp(sequence))
            assert [waiter.wait(0) for waiter in waiters] == [False] * readers


def test_a_notifier_never_fills_up_and_each_notification_counts(path, monkeypatch):
    notifier, listener = Notifier(path), NotificationListener(path)
    wait_set = WaitSet([listener])
    made_room = []

    def read(fd, octets):
        made_room.append(real_read(fd, octets))
        assert select.select([listener], [], [], 0)[0], "emptied: a slow listener would sleep on"

    real_read = os.read
    monkeypatch.setattr(notifier_module.os, "read", read)
    # More than a FIFO holds.
    for _ in range(140_000):
        notifier.notify()
    for _ in range(3):
        assert wait_set.wait(LONG_NS)
        assert not wait_set.wait(1_500_000)
        notifier.notify()
    assert wait_set.wait(LONG_NS)
    assert made_room


def test_waiting_continues_until_the_condition_holds(path):
    notifier, listener = Notifier(path), NotificationListener(path)
    first, second = WaitSet([listener]), WaitSet([listener])
    notifier.notify()
    reasons = iter([False, True])

    def awake():
        notifier.notify()
        return next(reasons)

    assert first.wait(LONG_NS, awake)
    assert second.wait(LONG_NS)
    assert not second.wait(0)
    assert not second.wait(-1)


def test_a_bus_closes_what_it_opened(session):
    def use():
        with TopicBus(session) as bus:
            writer, reader = bus.writer("numbers", max_octets=8), bus.reader("numbers")
            writer.publish_octets(bytes(8), stamp(0))
            assert reader.wait(0)
            reader.latest().release()
            assert not reader.wait(0)

    use()
    before = list(Path("/proc/self/fd").iterdir())
    for _ in range(3):
        use()
    assert len(list(Path("/proc/self/fd").iterdir())) == len(before)


def test_a_fifo_of_another_user_is_refused(path, tmp_path):
    path.touch()
    with pytest.raises(ConfigError, match=r"\.notifier is no FIFO of yours: remove it"):
        Notifier(path)
    path.unlink()
    own = tmp_path / "own"
    os.mkfifo(own)
    path.symlink_to(own)
    with pytest.raises(ConfigError, match=r"\.notifier is no FIFO of yours: remove it"):
        NotificationListener(path)
    path.unlink()
