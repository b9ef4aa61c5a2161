"""One publisher's process and its readers': what a publication costs, and how soon it is there."""

import multiprocessing
import signal
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from typing import Any

from kontur_av.clock import NS_PER_MS, NS_PER_S, MonotonicClock
from pipelines.bench.fanout.ways import ReadingEnd, Way, read_stamp

PICTURES_HZ = 30

_WARM, _PACED, _FAST, _END = range(4)
#: How long a reader waits before it looks which phase it is.
_LOOK_NS = 100 * NS_PER_MS
#: Between phases: each reader has looked, and taken what was still on its way.
_PAUSE_S = 0.3
#: For processes to start, to connect and to end, on a busy machine as well.
_PATIENCE_S = 60


@dataclass(frozen=True)
class FanOut:
    """What was found with so many readers; all instants in nanoseconds.

    At 30 pictures a second: `publish_ns`, the time in each publication, and `publish_cpu_ns`, for
    how much of it the publishing thread ran: the rest a reader may have had, where processors are
    few. `delivery_ns`, from the beginning of the publication until a reader holds the picture and
    has read its two ends, of all readers; `missed`, pictures that a reader never saw. CPU seconds,
    the publisher's with all its threads and its pauses.

    As fast as possible, for `fast_s`: likewise, the publisher's only.

    torn: pictures whose ends differed, of all.
    """

    way: str
    readers: int
    publish_ns: list[int] = field(repr=False)
    publish_cpu_ns: list[int] = field(repr=False)
    fast_publish_ns: list[int] = field(repr=False)
    publisher_cpu_s: float
    fast_cpu_s: float
    fast_s: float
    delivery_ns: list[int] = field(repr=False)
    missed: int
    torn: int
    readers_cpu_s: float


def fan_out(way: Way, readers: int, *, seconds: float, fast_s: float) -> FanOut:
    """Bring pictures to `readers` processes. RuntimeError when one of them fails."""
    # Forked, as a session's processes are; this one has no bus and no threads of GStreamer.
    processes = multiprocessing.get_context("fork")
    way.prepare(readers, processes)
    shared = _Shared(processes, readers)
    ends: list[Connection] = []
    children = []
    try:
        for number in range(-1, readers):
            told, tell = processes.Pipe(duplex=False)
            child = processes.Process(
                target=_publish if number < 0 else _read,
                args=(way, shared, tell, *((seconds, fast_s) if number < 0 else (number,))),
                daemon=True,
            )
            child.start()
            tell.close()
            children.append(child)
            ends.append(told)
        published, *read = _results(ends, seconds + fast_s + _PATIENCE_S)
        for child in children:
            child.join(_PATIENCE_S)
    finally:
        for child in children:
            child.kill()
            child.join()
        way.clear()
    return FanOut(
        way=way.name,
        readers=readers,
        **published,
        delivery_ns=[age_ns for one in read for age_ns in one["delivery_ns"]],
        missed=sum(len(published["publish_ns"]) - one["pictures"] for one in read),
        torn=sum(one["torn"] for one in read),
        readers_cpu_s=sum(one["cpu_s"] for one in read),
    )


class _Shared:
    """What the processes of one run have in common."""

    def __init__(self, processes: Any, readers: int) -> None:
        self.readers = readers
        self.phase = processes.RawValue("i", _WARM)
        #: The last picture before those that come 30 times a second.
        self.warm_pictures = processes.RawValue("q", 0)
        #: Open as soon as the publisher can be connected to.
        self.open = processes.Event()
        #: Counts the readers that have seen a picture.
        self.connected = processes.Semaphore(0)


def _results(ends: Sequence[Connection], within_s: float) -> list[dict[str, Any]]:
    """What each process has found, in the order of `ends`."""
    found: dict[Connection, dict[str, Any]] = {}
    deadline_s = time.monotonic() + within_s
    while len(found) < len(ends):
        ready = wait([end for end in ends if end not in found], deadline_s - time.monotonic())
        if not ready:
            raise RuntimeError("a process of the bench hangs")
        for end in ends:
            if end in ready:
                try:
                    found[end] = end.recv()
                except EOFError:
                    raise RuntimeError("a process of the bench has failed") from None
    return [found[end] for end in ends]


def _publish(way: Way, shared: _Shared, tell: Any, seconds: float, fast_s: float) -> None:
    # Ctrl-C is for the command.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    clock = MonotonicClock()
    end = way.publishing_end()
    shared.open.set()
    sequence = 0

    def publish() -> int:
        nonlocal sequence
        sequence += 1
        begun_ns = clock.now_ns()
        end.publish(begun_ns, sequence)
        return clock.now_ns() - begun_ns

    def publish_counting() -> tuple[int, int]:
        cpu_ns = time.thread_time_ns()
        return publish(), time.thread_time_ns() - cpu_ns

    connected = 0
    while connected < shared.readers:
        publish()
        connected += shared.connected.acquire(timeout=1 / PICTURES_HZ)

    shared.warm_pictures.value = sequence
    shared.phase.value = _PACED
    time.sleep(_PAUSE_S)
    cpu_ns = time.process_time_ns()
    begin_ns = clock.now_ns()
    published = []
    for number in range(round(seconds * PICTURES_HZ)):
        clock.sleep_until_ns(begin_ns + number * NS_PER_S // PICTURES_HZ)
        published.append(publish_counting())
    # What is left to a thread of the publisher is its cost as well.
    time.sleep(_PAUSE_S)
    paced_cpu_ns = time.process_time_ns() - cpu_ns

    shared.phase.value = _FAST
    time.sleep(_PAUSE_S)
    cpu_ns = time.process_time_ns()
    begin_ns = clock.now_ns()
    fast_publish_ns = []
    while clock.now_ns() - begin_ns < fast_s * NS_PER_S:
        fast_publish_ns.append(publish())
    lasted_ns = clock.now_ns() - begin_ns
    time.sleep(_PAUSE_S)
    fast_cpu_ns = time.process_time_ns() - cpu_ns

    shared.phase.value = _END
    time.sleep(_PAUSE_S)
    end.close()
    tell.send(
        {
            "publish_ns": [all_ns for all_ns, _ in published],
            "publish_cpu_ns": [cpu_ns for _, cpu_ns in published],
            "fast_publish_ns": fast_publish_ns,
            "publisher_cpu_s": paced_cpu_ns / NS_PER_S,
            "fast_cpu_s": fast_cpu_ns / NS_PER_S,
            "fast_s": lasted_ns / NS_PER_S,
        }
    )


def _read(way: Way, shared: _Shared, tell: Any, number: int) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    clock = MonotonicClock()
    shared.open.wait(_PATIENCE_S)
    end = way.reading_end(number)
    while _look(end, clock) is None:
        pass
    shared.connected.release()
    phase = _WARM
    cpu_ns = {}
    delivery_ns: list[int] = []
    torn = 0
    while phase != _END:
        if phase != shared.phase.value:
            phase = shared.phase.value
            cpu_ns[phase] = time.process_time_ns()
        found = _look(end, clock)
        if found is not None:
            age_ns, sequence, whole = found
            torn += not whole
            if phase == _PACED and sequence > shared.warm_pictures.value:
                delivery_ns.append(age_ns)
    end.close()
    tell.send(
        {
            "delivery_ns": delivery_ns,
            "pictures": len(delivery_ns),
            "torn": torn,
            "cpu_s": (cpu_ns[_FAST] - cpu_ns[_PACED]) / NS_PER_S,
        }
    )


def _look(end: ReadingEnd, clock: MonotonicClock) -> tuple[int, int, bool] | None:
    """How old the next picture is, its sequence, and whether it is whole."""
    picture = end.take(_LOOK_NS)
    if picture is None:
        return None
    stamped_ns, sequence, whole = read_stamp(picture)
    age_ns = clock.now_ns() - stamped_ns
    end.release()
    return age_ns, sequence, whole
