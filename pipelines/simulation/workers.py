"""Where pictures and sounds are coded while virtual time goes on: one process a stream's end.

A coding step takes a fixed virtual time, so its result is needed only when that is over: it is
begun at once and waited for then. What comes out depends on the jobs and their order alone.
"""

import multiprocessing
import pickle
import signal
import traceback
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from types import TracebackType
from typing import Any, Self

import cv2

from pipelines.runtime.launcher import keep_memory

#: Jobs in a batch.
_BATCH = 8

#: Does one job after the other. Made in the process in which it works.
Coder = Callable[[Any], Any]


class Job:
    """Something that is being done; `result` waits for it. Results come in the jobs' order."""

    def __init__(self, worker: "Worker") -> None:
        self._worker = worker
        self._done = False
        self._result: Any = None

    def result(self) -> Any:
        """What the coder gave. RuntimeError with the coder's own words where it failed."""
        while not self._done:
            self._worker.receive()
        return self._result

    def set(self, result: Any) -> None:
        """The coder gave this."""
        self._result, self._done = result, True


class Worker:
    """A process that does jobs; `submit` them, and ask each for its `result`."""

    def __init__(self, make: Callable[[], Coder], others: list[Connection]) -> None:
        context = multiprocessing.get_context("fork")
        self._link, theirs = context.Pipe()
        others.append(self._link)
        self._process = context.Process(
            target=_work, args=(make, theirs, list(others)), daemon=True
        )
        # OpenCV's threads are not there in the new process, which would wait for them for ever: end
        # them before. They come back when they are wanted.
        threads = cv2.getNumThreads()
        cv2.setNumThreads(1)
        # Amid a fork Python loses an interrupt here, and the new process does not ignore it yet.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT,))
        try:
            self._process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
            cv2.setNumThreads(threads)
        theirs.close()
        self._open: deque[Job] = deque()

    def submit(self, job: Any) -> Job:
        """Begin `job`, anything that can be pickled."""
        waiting = Job(self)
        self._open.append(waiting)
        self._link.send_bytes(pickle.dumps(job, pickle.HIGHEST_PROTOCOL))
        return waiting

    def receive(self) -> None:
        """Take the next result; wait for it if need be."""
        try:
            # Of a process of ours only: the pipe is nobody else's.
            fault, result = pickle.loads(self._link.recv_bytes())
        except (EOFError, ConnectionError):
            fault, result = "its process has ended", None
        if fault:
            raise RuntimeError(f"coding failed: {fault}")
        self._open.popleft().set(result)

    def close(self) -> None:
        """End the process."""
        self._link.close()
        self._process.join(5)
        if self._process.is_alive():
            self._process.kill()


class Batch:
    """Hands small jobs on many at a time: for results that nobody is in a hurry for.

    The worker's coder gets a list of jobs and gives a list of results.
    """

    def __init__(self, worker: Worker) -> None:
        self._worker = worker
        self._jobs: list[Any] = []
        self._submitted: deque[Job] = deque()
        self._results: deque[Any] = deque()

    def submit(self, job: Any) -> None:
        """Have `job` done sooner or later."""
        self._jobs.append(job)
        if len(self._jobs) == _BATCH:
            self._begin()

    def next_result(self) -> Any:
        """The result of the earliest job whose result was not asked for yet; waits for it."""
        while not self._results:
            if not self._submitted:
                self._begin()
            self._results.extend(self._submitted.popleft().result())
        return self._results.popleft()

    def _begin(self) -> None:
        self._submitted.append(self._worker.submit(self._jobs))
        self._jobs = []


class Workers:
    """All workers of a simulation; a context that ends them."""

    def __init__(self) -> None:
        self._workers: list[Worker] = []
        self._links: list[Connection] = []

    def start(self, make: Callable[[], Coder]) -> Worker:
        """A new process with the coder that `make` makes in it."""
        worker = Worker(make, self._links)
        self._workers.append(worker)
        return worker

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for worker in self._workers:
            worker.close()


def _work(make: Callable[[], Coder], link: Connection, others: list[Connection]) -> None:
    # Ctrl-C is the simulation's; its end is seen here once nobody else holds the pipe's other end.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, (signal.SIGINT,))
    for other in others:
        other.close()
    cv2.setNumThreads(1)
    keep_memory()
    # The simulation closes its end, perhaps with results unread, when it wants no more.
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
