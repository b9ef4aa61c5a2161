"""Worker processes that code pictures and sounds while virtual time goes on, one a stream's end.

`Scene` is what the parts of a simulated session share: these workers, an agenda, and figures.

A coding step takes a fixed virtual time. So it begins at once, and its result is needed only when
that time is over. Results depend on the jobs and their order alone.
"""

import multiprocessing
import pickle
import signal
import traceback
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from heapq import heappop, heappush
from multiprocessing.connection import Connection
from random import Random
from typing import Any

import cv2

from kontur_av.rtp.sender import RtpIdentity
from pipelines.media.media_metrics import CodingCosts
from pipelines.report.collector import Collector
from pipelines.session.launcher import keep_memory
from pipelines.session.probe import Probe
from pipelines.session.setup.segments import Segment
from pipelines.session.setup.table import Setup
from pipelines.session.topology.table import Topology
from telepresence.link.gateway import Gateway
from telepresence.world import WorldState

#: Called with the instant at which it is due.
Action = Callable[[int], object]

FAR_NS = 1 << 62
#: The instants of virtual time are Unix times.
WALL_OFFSET_NS = 0


class Agenda:
    """Actions sorted by instant; those of one instant in the order in which they were entered.

    next_ns: the instant of the first action; `FAR_NS` if there is none.
    """

    def __init__(self) -> None:
        self._entries: list[tuple[int, int, Action]] = []
        self._entered = 0
        self.next_ns = FAR_NS

    def at(self, instant_ns: int, action: Action) -> None:
        self._entered += 1
        heappush(self._entries, (instant_ns, self._entered, action))
        self.next_ns = self._entries[0][0]

    def do_next(self) -> None:
        instant_ns, _, action = heappop(self._entries)
        self.next_ns = self._entries[0][0] if self._entries else FAR_NS
        action(instant_ns)


class Timer:
    """Calls one action at the instant that a core's `poll_timeout` named last."""

    def __init__(self, agenda: Agenda, action: Action) -> None:
        self._agenda = agenda
        self._action = action
        self._due_ns = FAR_NS

    def set(self, due_ns: int | None, now_ns: int) -> None:
        """Set the instant, at least the next nanosecond; None: no action."""
        if due_ns is None:
            self._due_ns = FAR_NS
            return
        due_ns = max(due_ns, now_ns + 1)
        if due_ns != self._due_ns:
            self._due_ns = due_ns
            self._agenda.at(due_ns, self._expire)

    def _expire(self, now_ns: int) -> None:
        # An entry for an instant that was changed does nothing.
        if now_ns == self._due_ns:
            self._due_ns = FAR_NS
            self._action(now_ns)


class Telling:
    """The probe of each process, and the functions that fill them before each flush."""

    def __init__(self, collector: Collector) -> None:
        self._collector = collector
        self._probes: dict[str, Probe] = {}
        self._fills: list[Callable[[], object]] = []
        #: The instant of the flush.
        self.now_ns = 0
        #: Takes a function to call before each flush, which puts counters into its probe.
        self.add = self._fills.append

    @property
    def processes(self) -> list[str]:
        return list(self._probes)

    def probe(self, process: str) -> Probe:
        return self._probes.setdefault(process, Probe())

    def flush(self, now_ns: int) -> None:
        self.now_ns = now_ns
        for fill in self._fills:
            fill()
        for name, probe in self._probes.items():
            self._collector.handle_message(name, probe.message, now_ns)
            probe.handle_told(now_ns, told=True)


#: So many results wait in a worker's pipe at most.
_MOST_OPEN = 64
#: Does one job after the other. It is made in the worker process.
Coder = Callable[[Any], Any]


class Job:
    """A job in a worker. Results come in the order of the jobs."""

    def __init__(self, worker: "Worker") -> None:
        self._worker = worker
        self._done = False
        self._result: Any = None

    def result(self) -> Any:
        """Return the coder's result. Raises RuntimeError with the coder's message if it failed."""
        while not self._done:
            self._worker.receive()
        return self._result

    def set(self, result: Any) -> None:
        self._result, self._done = result, True


class Worker:
    """A process that does jobs: `start` it, `submit` each, and call its `result`."""

    def __init__(self, make: Callable[[], Coder], others: list[Connection]) -> None:
        context = multiprocessing.get_context("fork")
        self._link, theirs = context.Pipe()
        others.append(self._link)
        self._process = context.Process(
            target=_work, args=(make, theirs, list(others)), daemon=True
        )
        self._theirs = theirs
        self._open: deque[Job] = deque()

    def start(self) -> None:
        """Fork the process. Call it once, before the first job."""
        # A forked process has no threads of OpenCV, but would wait for them: end them before the
        # fork. OpenCV starts them again when it needs them.
        threads = cv2.getNumThreads()
        cv2.setNumThreads(1)
        # An interrupt during the fork would be lost here, or end the new process.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT,))
        try:
            self._process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
            cv2.setNumThreads(threads)
        self._theirs.close()

    def submit(self, job: Any) -> Job:
        # The pipe has no room for the results of many jobs that nobody asks for.
        while len(self._open) >= _MOST_OPEN:
            self.receive()
        waiting = Job(self)
        self._open.append(waiting)
        with suppress(ConnectionError):  # of a dead process: `receive` says so
            self._link.send_bytes(pickle.dumps(job, pickle.HIGHEST_PROTOCOL))
        return waiting

    def receive(self) -> None:
        try:
            # Unpickling is safe: only our own process writes to this pipe.
            fault, result = pickle.loads(self._link.recv_bytes())
        except (EOFError, ConnectionError):
            fault, result = "its process has ended", None
        if fault:
            raise RuntimeError(f"coding failed: {fault}")
        self._open.popleft().set(result)

    def close(self) -> None:
        self._link.close()
        self._process.join(5)
        if self._process.is_alive():
            self._process.kill()


class Workers(ExitStack):
    """All workers of a simulation. A context manager, which ends them."""

    def __init__(self) -> None:
        super().__init__()
        self._links: list[Connection] = []

    def start(self, make: Callable[[], Coder]) -> Worker:
        worker = Worker(make, self._links)
        worker.start()
        self.callback(worker.close)
        return worker


@dataclass(frozen=True, kw_only=True)
class Scene:
    """What the parts of a simulated session share.

    state_at: the newest state of the robot; robot: the same, None before the first.
    start_ns: when it begins. at_end: called with the instant when the session ends.
    """

    setup: Setup
    topology: Topology
    costs: CodingCosts
    seed: int
    agenda: Agenda
    telling: Telling
    workers: Workers
    gateways: Mapping[Segment, Gateway]
    state_at: Callable[[int], WorldState]
    robot: Callable[[], WorldState | None]
    start_ns: int
    at_end: list[Callable[[int], object]] = field(default_factory=list)

    def sending_gateway(self, stream: str) -> Gateway:
        return self.gateways[self.topology.media(stream).direction.sender]

    def random(self, what: str) -> Random:
        """The random numbers of one part, the same with the same seed."""
        return Random(f"{self.seed} {what}")

    def identity(self, stream: str) -> RtpIdentity:
        return RtpIdentity.draw(self.random(stream).getrandbits)


def _work(make: Callable[[], Coder], link: Connection, others: list[Connection]) -> None:
    # Only the simulation handles Ctrl-C. This process sees its end when the pipe closes, which
    # needs that no other process holds the pipe's other end.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, (signal.SIGINT,))
    for other in others:
        other.close()
    cv2.setNumThreads(1)
    keep_memory()
    # The simulation may close its end with results unread.
    with suppress(EOFError, ConnectionError):
        try:
            coder = make()
            while True:
                result = coder(pickle.loads(link.recv_bytes()))
                link.send_bytes(pickle.dumps(("", result), pickle.HIGHEST_PROTOCOL))
        except (EOFError, ConnectionError):
            return
        except BaseException:
            link.send_bytes(pickle.dumps((traceback.format_exc(), None)))
