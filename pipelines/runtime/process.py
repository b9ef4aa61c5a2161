"""What every process of a session has: the topology, a clock, a probe, a way to end."""

import ctypes
import gc
import os
import signal
import socket
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from kontur_av.clock import NS_PER_MS, MonotonicClock
from pipelines.runtime.probe import Probe
from pipelines.setup.table import Setup
from pipelines.topology import LOOP_PRIORITY, ProcessRow, Topology

if TYPE_CHECKING:
    from kontur_av.topics.bus import TopicBus

LOOPBACK = "127.0.0.1"
MAX_DATAGRAM_OCTETS = 65_535
#: The longest that a process sleeps before it checks whether it shall end.
PATIENCE_NS = 100 * NS_PER_MS

_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4
_PR_SET_PDEATHSIG, _PR_SET_NAME, _PR_SET_TIMERSLACK = 1, 15, 29


@dataclass
class Context:
    """What a process's function is given.

    It runs until `stopping`; it calls `tick` at least every PATIENCE_NS.

    started_ns: when the session began, the same for all lives of the part.
    seed: of the radio's random events.
    """

    session: str
    topology: Topology
    clock: MonotonicClock
    probe: Probe
    snapshots: Path | None = None
    started_ns: int = 0
    seed: int = 0
    stopping: bool = False
    _fill: list[Callable[[], None]] = field(default_factory=list)

    @property
    def setup(self) -> Setup:
        """What the user chose."""
        return self.topology.setup

    def first_deadline_ns(self, period_ns: int, phase: float = 0.0) -> int:
        """The first deadline of a loop in step with all others of its period in the session.

        phase: where in the period, from 0 to 1. Loops that hand samples to each other stand half
        a period apart: a sample is then half a period old when it is fetched, never one more or
        less because both woke at the same time.
        """
        now_ns = self.clock.now_ns()
        return (now_ns // period_ns + 2) * period_ns + round(phase * period_ns)

    def open_bus(self) -> "TopicBus":
        """This process's door to shared memory."""
        from kontur_av.topics.bus import TopicBus

        return TopicBus(self.session)

    def listen(self, port: int) -> socket.socket:
        """A UDP socket on loopback that never blocks."""
        udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        udp.setblocking(False)
        udp.bind((LOOPBACK, port))
        return udp

    def sender(self, port: int) -> Callable[[bytes], None]:
        """What sends one datagram to `port` on loopback; that nobody is there is not its concern.

        It has a connected socket of its own: the kernel looks the way up once, not each time.
        """
        udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        udp.setblocking(False)
        udp.connect((LOOPBACK, port))
        send_now = udp.send

        def send(data: bytes) -> None:
            try:
                send_now(data)
            except (BlockingIOError, ConnectionError):
                # The answer to an earlier datagram: this one has not been sent because of it.
                with suppress(BlockingIOError, ConnectionError):
                    send_now(data)

        return send

    @staticmethod
    def receive(udp: socket.socket, most_octets: int = MAX_DATAGRAM_OCTETS) -> bytes | None:
        """The next datagram, or None; an ICMP error of an earlier send is nobody's concern.

        most_octets: what is longer is cut. One octet more than anything that will be used tells
        as much as the whole, and spares a buffer of 64 KiB.
        """
        while True:
            try:
                return udp.recv(most_octets)
            except BlockingIOError:
                return None
            except ConnectionError:
                continue

    def on_flush(self, fill: Callable[[], None]) -> None:
        """Have `fill` put its totals and gauges into the probe before each flush."""
        self._fill.append(fill)

    def tick(self, now_ns: int) -> None:
        """Flush the probe when it is time."""
        if self.probe.due(now_ns):
            self.flush(now_ns)

    def flush(self, now_ns: int) -> None:
        """Flush the probe now."""
        for fill in self._fill:
            fill()
        self.probe.flush(now_ns)


def become(row: ProcessRow, context: Context) -> None:
    """In a fresh child: take the process's name, its priority and its way to end."""
    # Ctrl-C and the end of the terminal reach every process, but only the launcher acts on them.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: setattr(context, "stopping", True))
    libc = ctypes.CDLL(None, use_errno=True)
    prctl = libc.prctl
    # A launcher that is killed takes its processes along.
    prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    prctl(_PR_SET_NAME, f"kav {row.name}".encode()[:15])
    if row.priority:
        context.probe.gauge("scheduler", _take_realtime(libc, row.priority))


def _take_realtime(libc: ctypes.CDLL, priority: int) -> str:
    if priority == LOOP_PRIORITY:
        # No collection in the middle of a slot: these loops make no reference cycles.
        gc.collect()
        gc.freeze()
        gc.disable()
        # What was touched once is never paged out again. Where it is not permitted: no harm.
        libc.mlockall(_MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError:
        # Without permission at least no timer is rounded up (the default is 50 µs).
        libc.prctl(_PR_SET_TIMERSLACK, 1)
        return "other"
    return "fifo"
