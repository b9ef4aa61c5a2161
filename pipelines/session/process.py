"""The context of every process of a session: topology, clock, probe, and how it ends."""

import ctypes
import gc
import os
import signal
import socket
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from kontur_av.clock import NS_PER_MS, NS_PER_S, MonotonicClock
from pipelines.session import datagrams
from pipelines.session.command_process import end_with_parent
from pipelines.session.page_sockets import PageListener
from pipelines.session.probe import Probe
from pipelines.session.session_metrics import SessionNews
from pipelines.session.session_switch import Order, ProcessOrder
from pipelines.session.setup.table import Setup
from pipelines.session.topology.rows import (
    LOOP_PRIORITY,
    PICTURE_PRIORITY,
    WATCHER_PRIORITY,
    ProcessRow,
)
from pipelines.session.topology.table import Topology

if TYPE_CHECKING:
    from kontur_av.topics.bus import TopicBus

#: The longest sleep of a process before it checks whether to end.
TIMEOUT_NS = 100 * NS_PER_MS


def wait_ns(now_ns: int, *dues_ns: int | None) -> int:
    """Return how long to sleep until the first of these instants, at most `TIMEOUT_NS`."""
    waits_ns = [due_ns - now_ns for due_ns in dues_ns if due_ns is not None]
    return max(0, min([TIMEOUT_NS, *waits_ns]))


#: Collect garbage once in this many flushes, twice a minute. It takes 0.1 to 0.3 ms, for pages 3.
_COLLECT_EVERY = 60

#: Real-time priority is judged over this time.
_SHARE_NS = 2 * NS_PER_S

#: The longest message of the launcher to a process.
_MAX_NEWS_OCTETS = 1 << 20
_NEWS = msgspec.json.Decoder(SessionNews)

_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4
_PR_SET_NAME, _PR_SET_TIMERSLACK = 15, 29


@dataclass
class Context:
    """The argument of a process's function.

    The function returns when `stopping` is set, and calls `tick` at least every `TIMEOUT_NS`.

    link: the socket to the launcher; None: nobody takes the figures.
    started_ns: when the session began, the same for all starts of a process.
    seed: of the radio's random events.
    pages: by process, where its browser pages are served.
    takes_power: only take the power of the device: the life before could not.
    """

    session: str
    topology: Topology
    clock: MonotonicClock
    probe: Probe = field(default_factory=Probe)
    link: socket.socket | None = None
    snapshots: Path | None = None
    started_ns: int = 0
    seed: int = 0
    stopping: bool = False
    pages: Mapping[str, PageListener] = field(default_factory=dict)
    takes_power: bool = False
    _fill: list[Callable[[], None]] = field(default_factory=list)
    #: Descriptors of the session.
    _own: list[int] = field(default_factory=list)

    @property
    def setup(self) -> Setup:
        return self.topology.setup

    def first_deadline_ns(self, period_ns: int, phase: float = 0.0) -> int:
        """Return the first deadline of a loop, in step with all loops of the same period.

        phase: the place in the period, from 0 to 1. Loops that exchange samples run half a period
        apart, so that a sample is always half a period old when it is fetched.
        """
        now_ns = self.clock.now_ns()
        return (now_ns // period_ns + 2) * period_ns + round(phase * period_ns)

    def open_bus(self) -> "TopicBus":
        from kontur_av.topics.bus import TopicBus

        return TopicBus(self.session)

    def listen(self, port: int) -> socket.socket:
        """Open a UDP socket on loopback that never blocks, for datagrams of any sender."""
        return self._owned(datagrams.listen((datagrams.LOOPBACK, port)))

    def listen_media(self, port: int) -> socket.socket:
        """Open a UDP socket for datagrams of the session's own gateway; see `OWN_SENDERS`."""
        addresses = (datagrams.LOOPBACK, port), (datagrams.OWN_SENDERS, port)
        return self._owned(datagrams.listen_to(*addresses))

    def sender(self, port: int) -> Callable[[bytes], None]:
        """Return a function that sends one datagram to `port` on loopback, from `OWN_SENDERS`.

        It ignores a port without a listener.
        """
        return datagrams.outlet(datagrams.OWN_SENDERS, (datagrams.LOOPBACK, port), port=port).send

    def listen_own(self, port: int) -> socket.socket:
        """Open the session's own socket in the place of `port`, which its user alone reaches."""
        return self._owned(datagrams.listen_own(self.session, port))

    def own_sender(self, port: int) -> Callable[[bytes], None]:
        """Return a function that sends one datagram to the session's own socket for `port`."""
        return datagrams.OwnOutlet(self.session, port).send

    def _owned(self, udp: socket.socket) -> socket.socket:
        self._own.append(udp.fileno())
        return udp

    def own_open_files(self) -> None:
        """All open files are the session's: a process that a user's driver forks closes them."""
        self._own += [fd for fd in range(3, 1024) if os.path.lexists(f"/proc/self/fd/{fd}")]
        os.register_at_fork(after_in_child=self._leave)

    def _leave(self) -> None:
        for fd in self._own:
            with suppress(OSError):
                os.close(fd)

    def on_flush(self, fill: Callable[[], None]) -> None:
        """Call `fill` before each flush, to put counters and gauges into the probe."""
        self._fill.append(fill)

    def tick(self, now_ns: int) -> None:
        if self.probe.due(now_ns):
            self.flush(now_ns)

    def flush(self, now_ns: int) -> None:
        for fill in self._fill:
            fill()
        self.send_metrics(now_ns)

    def send_metrics(self, now_ns: int) -> None:
        """Send what the probe has collected; what the launcher cannot take stays there."""
        told = True
        if self.link is not None:
            try:
                self.link.send(self.probe.message.pack(), socket.MSG_DONTWAIT)
            except OSError:
                told = False
        self.probe.handle_told(now_ns, told=told)

    def order(self, order: Order | ProcessOrder, now_ns: int) -> None:
        """Ask the launcher to stop or to start the session, if this serves pages, or a process."""
        self.probe.message.orders.append(order)
        self.flush(now_ns)

    def receive_news(self) -> SessionNews | None:
        """Return the launcher's next message, or None; it never blocks.

        `link` becomes readable when a message waits, so that an event loop can watch
        `link.fileno()`. Pages get messages only while `PageMetrics` says that somebody watches.
        """
        if self.link is None:
            return None
        try:
            text = self.link.recv(_MAX_NEWS_OCTETS, socket.MSG_DONTWAIT)
        except OSError:
            return None
        return _NEWS.decode(text) if text else None


def become(row: ProcessRow, context: Context) -> None:
    """Set the name, priority and signal handlers of a freshly forked process."""
    # Ctrl-C and the end of the terminal reach every process, but only the launcher handles them.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: setattr(context, "stopping", True))
    context.own_open_files()
    # When the launcher is killed, its processes end, too.
    end_with_parent()
    ctypes.CDLL(None).prctl(_PR_SET_NAME, f"kav {row.name}".encode()[:15])
    if row.priority == WATCHER_PRIORITY:
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
        context.probe.message.scheduler = "idle"
    elif row.priority:
        context.probe.message.scheduler = take_realtime(row.priority)
        if row.priority == PICTURE_PRIORITY and context.probe.message.scheduler == "fifo":
            context.on_flush(partial(_judge_share, context, RealtimeShare()))
    context.on_flush(Collections().handle_flush)


class Collections:
    """Frees what Python keeps: up to 2000 freed tuples of each length, until a full collection."""

    def __init__(self) -> None:
        self._flushes = 0

    def handle_flush(self) -> None:
        """Call it once or twice a second."""
        self._flushes += 1
        if self._flushes % _COLLECT_EVERY == 0:
            gc.collect()


class RealtimeShare:
    """Whether a process keeps its real-time priority: not if it takes more than half a core.

    Above pages and the rest of the system it would leave them nothing. `kept` stays False.
    """

    def __init__(self) -> None:
        self.kept = True
        self._since: tuple[int, int] | None = None

    def handle_time(self, now_ns: int, cpu_ns: int) -> None:
        """Call it about twice a second, with the CPU time of the process so far."""
        since_ns, before_ns = self._since or (now_ns, cpu_ns)
        if now_ns - since_ns >= _SHARE_NS:
            self.kept = self.kept and 2 * (cpu_ns - before_ns) <= now_ns - since_ns
            since_ns, before_ns = now_ns, cpu_ns
        self._since = since_ns, before_ns


def _judge_share(context: Context, share: RealtimeShare) -> None:
    if not share.kept:
        return
    share.handle_time(context.clock.now_ns(), time.process_time_ns())
    if not share.kept:
        for thread in Path("/proc/self/task").iterdir():
            with suppress(ProcessLookupError):
                os.sched_setscheduler(int(thread.name), os.SCHED_OTHER, os.sched_param(0))
        context.probe.message.scheduler = "too_busy"


def take_realtime(priority: int) -> str:
    """Run this process with a real-time priority if that is allowed; "fifo", else "other"."""
    libc = ctypes.CDLL(None, use_errno=True)
    if priority == LOOP_PRIORITY:
        # No garbage collection during a slot: these loops make no reference cycles.
        gc.collect()
        gc.freeze()
        gc.disable()
        # Touched pages stay in memory. Without permission this has no effect.
        libc.mlockall(_MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError:
        # Without permission, at least do not round timers up (by 50 µs by default).
        libc.prctl(_PR_SET_TIMERSLACK, 1)
        return "other"
    return "fifo"
