"""The processes of `bench fanout`: one publisher and its readers, and their times."""

import multiprocessing
import signal
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from typing import Any

from benchmarks.fanout.ways import ReadingEnd, Way, read_stamp
from kontur_av.clock import NS_PER_MS, NS_PER_S, MonotonicClock

PICTURES_HZ = 30

_WARM, _PACED, _FAST, _END = range(4)
#: How long a reader waits for a picture before it looks at the phase.
_LOOK_NS = 100 * NS_PER_MS
#: Between phases: longer than `_LOOK_NS`, so that every reader has drained what was on its way.
_PAUSE_S = 0.3
#: For processes to start, to connect and to end, also on a busy machine.
_PATIENCE_S = 60


@dataclass(frozen=True)
class FanOut:
    """Figures of one way with one number of readers; durations in ns.

    At 30 pictures a second: `publish_ns`, wall time of each publication; `publish_cpu_ns`, CPU time
    of the publishing thread in it. `delivery_ns`: from the beginning of the publication until a
    reader holds the picture and has read both its ends, of all readers. `missed`: pictures that a
    reader never saw. `publisher_cpu_s` counts all threads of the publisher, pauses included.

    fast_*: as fast as possible for `fast_s`, of the publisher only.

    torn: pictures whose two ends differed.
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
    # Fork, as a session does; this process has no bus and no threads of GStreamer yet.
    processes = multiprocessing.get_context("fork")
    way.prepare(readers, processes)
    shared = _Shared(processes, readers)
    ends: list[Connection] = []
    children = []
    try:
        for number in range(-1, readers):
            result_end, results = processes.Pipe(duplex=False)
            child = processes.Process(
                target=_publish if number < 0 else _read,
                args=(way, shared, results, *((seconds, fast_s) if number < 0 else (number,))),
                daemon=True,
            )
            child.start()
            results.close()
            children.append(child)
            ends.append(result_end)
        published, *read = _results(ends, seconds + fast_s + _PATIENCE_S)
        for child in children:
            child.join(_PATIENCE_S)
    finally:
        for child in children:
            child.kill()
            child.join()
        way.clear()
    assert isinstance(published, _Published)
    readings = [one for one in read if isinstance(one, _Read)]
    return FanOut(
        way=way.name,
        readers=readers,
        publish_ns=published.publish_ns,
        publish_cpu_ns=published.publish_cpu_ns,
        fast_publish_ns=published.fast_publish_ns,
        publisher_cpu_s=published.publisher_cpu_s,
        fast_cpu_s=published.fast_cpu_s,
        fast_s=published.fast_s,
        delivery_ns=[age_ns for one in readings for age_ns in one.delivery_ns],
        missed=sum(len(published.publish_ns) - len(one.delivery_ns) for one in readings),
        torn=sum(one.torn for one in readings),
        readers_cpu_s=sum(one.cpu_s for one in readings),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Published:
    """The publisher's result; as in `FanOut`."""

    publish_ns: list[int]
    publish_cpu_ns: list[int]
    fast_publish_ns: list[int]
    publisher_cpu_s: float
    fast_cpu_s: float
    fast_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class _Read:
    """A reader's result; as in `FanOut`."""

    delivery_ns: list[int]
    torn: int
    cpu_s: float


class _Shared:
    """State that the processes of one run share."""

    def __init__(self, processes: Any, readers: int) -> None:
        self.readers = readers
        self.phase = processes.RawValue("i", _WARM)
        #: The last picture before those that come 30 times a second.
        self.warm_pictures = processes.RawValue("q", 0)
        #: Set when readers can connect to the publisher.
        self.open = processes.Event()
        #: Counts the readers that have seen a picture.
        self.connected = processes.Semaphore(0)


def _results(ends: Sequence[Connection], within_s: float) -> list[_Published | _Read]:
    """The results of the processes, in the order of `ends`."""
    found: dict[Connection, _Published | _Read] = {}
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


def _publish(way: Way, shared: _Shared, results: Any, seconds: float, fast_s: float) -> None:
    # Ctrl-C is for the parent, which ends its children.
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
    # Work that another thread of the publisher still does counts as its cost.
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
    results.send(
        _Published(
            publish_ns=[all_ns for all_ns, _ in published],
            publish_cpu_ns=[cpu_ns for _, cpu_ns in published],
            fast_publish_ns=fast_publish_ns,
            publisher_cpu_s=paced_cpu_ns / NS_PER_S,
            fast_cpu_s=fast_cpu_ns / NS_PER_S,
            fast_s=lasted_ns / NS_PER_S,
        )
    )


def _read(way: Way, shared: _Shared, results: Any, number: int) -> None:
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
    results.send(
        _Read(
            delivery_ns=delivery_ns,
            torn=torn,
            cpu_s=(cpu_ns[_FAST] - cpu_ns[_PACED]) / NS_PER_S,
        )
    )


def _look(end: ReadingEnd, clock: MonotonicClock) -> tuple[int, int, bool] | None:
    """The age of the next picture, its sequence, and whether it is whole; None if there is none."""
    picture = end.take(_LOOK_NS)
    if picture is None:
        return None
    stamped_ns, sequence, whole = read_stamp(picture)
    age_ns = clock.now_ns() - stamped_ns
    end.release()
    return age_ns, sequence, whole
