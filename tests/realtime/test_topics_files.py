"""Topics as files: what was overwritten meanwhile is never read; a sample may outgrow its ring."""

import errno
import multiprocessing
import os

import numpy as np
import pytest

from kontur_av.errors import ConfigError
from kontur_av.media import CaptureStamp
from kontur_av.topics import file_node
from kontur_av.topics.bus import TopicBus
from kontur_av.topics.file_node import FilePublisher

pytestmark = pytest.mark.parametrize("session", ["files"], indirect=True)

OCTETS = 200_000


def stamp(sequence):
    return CaptureStamp(0, sequence, "x")


def publish(session, count):
    with TopicBus(session) as bus:
        writer = bus.writer("pictures", max_octets=OCTETS)
        for sequence in range(count):
            writer.publish_octets(bytes([sequence % 251]) * OCTETS, stamp(sequence))


def test_two_writers_that_never_wait_give_whole_samples_in_order(session):
    with TopicBus(session) as bus:
        reader = bus.reader("pictures", depth=32)
        spawn = multiprocessing.get_context("spawn")
        writers = [spawn.Process(target=publish, args=(session, 1000)) for _ in range(2)]
        for writer in writers:
            writer.start()
        seen = 0
        while seen < 700 and (reader.wait(100_000_000) or any(w.is_alive() for w in writers)):
            while (lease := reader.next()) is not None:
                with lease:
                    assert len(lease.payload) == OCTETS
                    assert (lease.payload == lease.stamp.sequence % 251).all()
                seen += 1
        for writer in writers:
            writer.join()
            assert writer.exitcode == 0
    assert seen > 0


def test_a_sample_that_is_overwritten_while_it_is_read_is_left_out(session, monkeypatch):
    with TopicBus(session) as bus:
        writer = bus.writer("pictures", max_octets=OCTETS)
        reader = bus.reader("pictures", depth=4)
        writer.publish_octets(b"a" * OCTETS, stamp(0))
        real = os.preadv

        def overtaken(fd, buffers, offset):
            monkeypatch.setattr(file_node.os, "preadv", real)
            for sequence in range(1, 9):
                writer.publish_octets(bytes([sequence]) * OCTETS, stamp(sequence))
            return real(fd, buffers, offset)

        monkeypatch.setattr(file_node.os, "preadv", overtaken)
        seen = []
        while (lease := reader.next()) is not None:
            seen.append((lease.stamp.sequence, int(lease.payload[0])))
        assert seen == [(5, 5), (6, 6), (7, 7), (8, 8)]


def test_a_record_of_any_size_is_read_whole_and_a_larger_one_makes_a_larger_ring(session):
    with TopicBus(session) as bus:
        writer, reader = bus.writer("units", max_octets=16), bus.reader("units", depth=8)
        rng = np.random.default_rng(3)
        sizes = [1, 16, 300_000, 5, 2_000_000, 0, *rng.integers(0, 3000, 1000)]
        for sequence, octets in enumerate(sizes):
            data = rng.bytes(int(octets))
            writer.publish_octets(data, stamp(sequence))
            lease = reader.next()
            assert (lease.stamp.sequence, lease.octets()) == (sequence, data)
        assert reader.next() is None


def test_a_writer_without_room_says_so_and_takes_nothing(session, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    with TopicBus(session) as bus:
        monkeypatch.setattr(file_node.os, "posix_fallocate", full)
        with pytest.raises(ConfigError, match="shared memory is full"):
            bus.writer("pictures", max_octets=OCTETS)
        monkeypatch.undo()


def test_a_writer_killed_within_a_record_leaves_the_topic_usable(session, monkeypatch):
    with TopicBus(session) as bus:
        first, second = (bus.writer("units", max_octets=64) for _ in range(2))
        reader = bus.reader("units", depth=8)
        put = FilePublisher._put

        def killed(self, at, number):
            put(self, at, number)
            raise SystemExit

        monkeypatch.setattr(FilePublisher, "_put", killed)
        with pytest.raises(SystemExit):
            first.publish_octets(b"half", stamp(0))
        monkeypatch.setattr(FilePublisher, "_put", put)
        second.publish_octets(b"whole", stamp(1))
        assert reader.next().octets() == b"whole"
        assert reader.next() is None
