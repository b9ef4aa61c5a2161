"""Shared-memory topics: real shared memory, real processes, one of them killed."""

import multiprocessing
import os
import socket
import subprocess
import sys
import tempfile
import time
from subprocess import PIPE

import numpy as np
import pytest
from common import TIMEOUT_S

from kontur_av.clock import MonotonicClock
from kontur_av.errors import ConfigError
from kontur_av.media import AudioFrame, CaptureStamp, VideoFrame
from kontur_av.topics import session_files
from kontur_av.topics.bus import TopicBus
from kontur_av.topics.session_files import (
    choose_session,
    remove_session,
    session_root,
    sessions,
    shared_memory,
)
from pipelines.cli import exit_code
from pipelines.session.sessions import launched_sessions

PICTURE_OCTETS = 64 * 48 * 3 // 2
PICTURE = np.zeros((72, 64), np.uint8)
LONG_NS = 20_000_000_000


@pytest.fixture
def bus(session):
    with TopicBus(session) as bus:
        yield bus


def stamp(sequence):
    return CaptureStamp(1_000 + sequence, sequence, "left")


def numbers(reader):
    """The sequence of each sample that is to be read, in turn."""
    seen = []
    while (lease := reader.next()) is not None:
        with lease:
            seen.append(lease.stamp.sequence)
    return seen


def test_latest_returns_the_newest_and_next_each_in_turn(bus):
    writer = bus.writer("pictures", max_octets=PICTURE_OCTETS)
    newest, each = bus.reader("pictures"), bus.reader("pictures", depth=4)
    for sequence in range(3):
        before_ns = MonotonicClock().now_ns()
        loan = writer.loan_picture(64, 48)
        loan.picture[:] = sequence
        loan.publish(stamp(sequence))
    assert newest.wait(0)
    with newest.latest() as lease:
        frame = lease.video()
        assert frame.stamp == stamp(2)
        assert before_ns <= lease.published_ns <= MonotonicClock().now_ns()
        assert (frame.width, frame.height) == (64, 48)
        assert (frame.data == 2).all()
    for sequence in range(3):
        with each.next() as lease:
            assert (lease.stamp.sequence, lease.video().data[0, 0]) == (sequence, sequence)
    assert each.next() is None


def test_sound_is_read_as_it_was_published(bus):
    writer, reader = bus.writer("voice", max_octets=1920), bus.reader("voice", depth=8)
    samples = np.arange(-480, 480, dtype=np.int16)
    writer.publish_audio(AudioFrame(samples, stamp(7)))
    with reader.next() as lease:
        assert (lease.audio().samples == samples).all()
        assert lease.audio().stamp == stamp(7)


def test_a_guest_joins_existing_topics_and_creates_none(session, bus):
    writer = bus.writer("pictures", max_octets=16)
    with TopicBus.join(session.rpartition("-")[0]) as guest:
        assert guest.topics() == ["pictures"]
        reader = guest.reader("pictures")
        writer.publish_octets(b"there", stamp(0))
        assert reader.next().octets() == b"there"
        before = sorted(shared_memory(session))
        with pytest.raises(ConfigError, match="no topic sounds: it has pictures"):
            guest.reader("sounds")
        assert sorted(shared_memory(session)) == before
    absent = f"{session}-not"
    with pytest.raises(ConfigError, match=f"no session {absent} is running"):
        TopicBus.join(absent)
    assert not shared_memory(absent) and not session_root(absent).exists()


def test_a_slow_reader_loses_the_oldest_and_never_blocks_the_writer(bus):
    writer = bus.writer("pictures", max_octets=PICTURE_OCTETS)
    slow = bus.reader("pictures", depth=2)
    for sequence in range(100):
        writer.publish_video(VideoFrame(PICTURE, stamp(sequence)))
    assert numbers(slow) == [98, 99]


def test_a_reader_that_holds_two_samples_may_still_look_for_the_newest(bus):
    """The stereo merge does so when it shows a camera's last picture again.

    A deeper queue stands for publications between the steps of `latest`.
    """
    writer = bus.writer("pictures", max_octets=PICTURE_OCTETS)
    reader, held = bus.reader("pictures", depth=4), []
    for first, last in ((0, 0), (1, 3)):
        for sequence in range(first, last + 1):
            writer.publish_video(VideoFrame(PICTURE, stamp(sequence)))
        held.append(reader.latest())
    assert [lease.stamp.sequence for lease in held] == [0, 3]
    for sequence in (4, 5, 6):
        writer.publish_video(VideoFrame(PICTURE, stamp(sequence)))
    held[0].release()
    assert reader.latest().stamp.sequence == 6


def test_a_reader_that_joins_late_begins_with_the_next_sample_and_is_counted(bus):
    """A camera that is drawn only while somebody reads it is such a topic."""
    writer = bus.writer("pictures", max_octets=PICTURE_OCTETS)
    assert not writer.has_readers() and writer.joins() == 0
    writer.publish_video(VideoFrame(PICTURE, stamp(0)))
    loan = writer.loan_picture(64, 48)
    reader = bus.reader("pictures")
    assert writer.has_readers()
    assert reader.latest() is None
    loan.publish(stamp(1))
    assert numbers(reader) == [1]
    reader.close()
    assert not writer.has_readers()
    # Who takes the place of a reader has joined.
    bus.reader("pictures")
    assert writer.joins() == 2


def test_a_waiter_wakes_for_a_socket_and_for_a_topic(bus):
    read_fd, write_fd = os.pipe()
    writer = bus.writer("a", max_octets=8)
    readers = [bus.reader("a"), bus.reader("b")]
    waiter = bus.waiter(readers, [read_fd])
    writer.publish_octets(b"x", stamp(0))
    waiter.wait(LONG_NS)  # returns at once, or the test hangs
    assert readers[0].latest() is not None
    os.write(write_fd, b"!")
    waiter.wait(LONG_NS)
    assert os.read(read_fd, 1) == b"!"
    del waiter
    os.close(read_fd)
    os.close(write_fd)


def _publish_for_ever(session):
    writer = TopicBus(session).writer("pictures", max_octets=PICTURE_OCTETS)
    for sequence in range(1_000_000):
        writer.publish_video(VideoFrame(PICTURE, stamp(sequence)))
        time.sleep(0.002)


def _hold_for_ever(session):
    reader, held = TopicBus(session).reader("pictures"), []
    while True:
        if reader.wait(LONG_NS) and len(held) < 2:
            held.append(reader.latest())


def _tell_what_arrives(session, publish):
    reader = TopicBus(session).reader("pictures")
    while True:
        # A writer that starts under an emulated processor may take longer.
        if reader.wait(LONG_NS) and (lease := reader.latest()):
            with lease:
                publish.send(lease.stamp.sequence)


def test_a_killed_writer_and_a_killed_reader_leave_the_others_running(session):
    """More kills than allowed writers at once: resources of killed processes are freed."""
    # Not forked: this process has had a bus, and a child would inherit its locks.
    spawn = multiprocessing.get_context("spawn")
    told, publish = spawn.Pipe(duplex=False)

    def start(work, *arguments):
        process = spawn.Process(target=work, args=(session, *arguments), daemon=True)
        process.start()
        return process

    running = [start(_tell_what_arrives, publish)]
    try:
        for _ in range(5):
            running += [start(_hold_for_ever), start(_publish_for_ever)]
            seen = []
            while len(seen) < 20:
                assert told.poll(TIMEOUT_S), "no more samples arrive"
                seen.append(told.recv())
            assert seen[-1] > seen[-10]
            for _ in range(2):
                victim = running.pop()
                victim.kill()
                victim.join()
            while told.poll(0.05):
                told.recv()
    finally:
        for process in running:
            process.kill()
            process.join()


def test_an_invalid_session_name_or_size_is_refused(bus):
    with pytest.raises(ConfigError, match="session name"):
        TopicBus("../etc")
    with pytest.raises(ConfigError, match="size 63x48"):
        bus.writer("x", max_octets=10).loan_picture(63, 48)


@pytest.mark.parametrize("octets", [1, 12, 90])
def test_a_long_name_in_a_deep_directory_leaves_room_for_a_socket(monkeypatch, tmp_path, octets):
    # A socket's path has at most 107 octets, and the user's number in it may be long, too.
    directory = tmp_path / ("d" * octets)
    directory.mkdir()
    monkeypatch.setenv("TMPDIR", str(directory))
    monkeypatch.setattr(os, "getuid", lambda: 1_234_567_890)
    # The directory belongs to another user.
    monkeypatch.setattr(session_files, "_check_own", lambda directory: None)
    name = "l" * 31
    with TopicBus(name) as bus:
        reader = bus.reader("pictures")
        bus.writer("pictures", max_octets=1).publish_octets(b"x", stamp(0))
        assert reader.wait(0)
        assert shared_memory(name)
        with socket.socket(socket.AF_UNIX) as short:
            short.bind(str(session_root(name) / "console"))
        user_root = session_root(name).parent
    # The last bus leaves what others keep there.
    assert not shared_memory(name) and session_root(name).exists()
    remove_session(name)
    assert not shared_memory(name)
    assert list(user_root.iterdir()) == []
    user_root.rmdir()


def test_without_room_for_its_files_a_bus_says_so(monkeypatch, capsys):
    iox2 = pytest.importorskip("iceoryx2")

    class Builder:
        new = config = signal_handling_mode = lambda self, *_: self

        def create(self, _kind):
            raise iox2.NodeCreationFailure("InternalError")

    monkeypatch.setattr(iox2, "NodeBuilder", Builder())
    monkeypatch.delenv("KONTUR_AV_TOPICS", raising=False)
    name = f"full-{os.getpid()}"
    assert exit_code(lambda: TopicBus(name), "kontur-av") == 1
    remove_session(name)
    (line,) = capsys.readouterr().err.splitlines()
    assert line.endswith("no file can be made there (InternalError): free some room")


@pytest.mark.skipif(os.getuid() != 0, reason="needs root, to become another user")
def test_another_user_can_open_nothing_of_a_session(session, bus):
    bus.writer("pictures", max_octets=PICTURE_OCTETS), bus.reader("pictures")
    paths = [*shared_memory(session), *session_root(session).rglob("*")]
    assert paths
    child = os.fork()
    if not child:
        os.setuid(65_534)
        os._exit(sum(os.access(path, os.R_OK) or os.access(path, os.W_OK) for path in paths))
    assert os.waitpid(child, 0)[1] == 0
    # And is told whose the session is.
    for path in shared_memory(session):
        os.chown(path, 65_534, -1)
    with pytest.raises(ConfigError, match=r"one of user nobody: .*sudo -u nobody kontur-av"):
        choose_session(None, [])


def test_a_directory_that_others_can_write_to_is_not_used(monkeypatch, tmp_path):
    # Not tmp_path itself, which may be too deep for sockets.
    with tempfile.TemporaryDirectory(prefix="kav") as directory:
        monkeypatch.setenv("TMPDIR", directory)
        own = session_root("lab").parent
        own.mkdir()
        own.chmod(0o777)
        with pytest.raises(ConfigError, match=f"{own}.*chmod 700"):
            TopicBus("lab")
        own.rmdir()
        own.symlink_to(tmp_path)
        with pytest.raises(ConfigError, match=f"{own}.*TMPDIR"):
            TopicBus("lab")
        own.unlink()
        own.mkdir(mode=0o700)
        theirs = own.stat().st_uid + 1
        monkeypatch.setattr(os, "getuid", lambda: theirs)
        own.rename(own.with_name(f"kontur-av-{theirs}"))
        with pytest.raises(ConfigError, match="no directory of yours"):
            TopicBus("lab")
    assert list(tmp_path.iterdir()) == []


def test_the_last_bus_of_a_users_own_topics_leaves_nothing_behind_and_is_no_session(session):
    first = TopicBus(session)
    reader, writer = first.reader("pictures"), first.writer("pictures", max_octets=1)
    with TopicBus(session) as second:
        second.reader("pictures")
    writer.publish_octets(b"x", stamp(0))
    assert reader.latest_octets() == b"x"
    assert session in sessions() and session not in launched_sessions()
    # A killed user holds nothing.
    command = "import sys; from kontur_av import TopicBus; TopicBus(sys.argv[1]); print(flush=True)"
    killed = [sys.executable, "-c", f"{command}; sys.stdin.read()", session]
    with subprocess.Popen(killed, stdin=PIPE, stdout=PIPE) as user:
        user.stdout.readline()
        first.close()
        assert shared_memory(session)
        user.kill()
    with TopicBus(session):
        pass
    assert not shared_memory(session) and not session_root(session).exists()


@pytest.mark.parametrize("octets", [10**12, 0, "5", np.float64(0.5)])
def test_a_size_that_no_sample_can_have_is_refused_in_one_line(session, octets):
    with TopicBus(session) as bus, pytest.raises(ConfigError, match=r"^max_octets [^\n]*$"):
        bus.writer("pictures", max_octets=octets)
