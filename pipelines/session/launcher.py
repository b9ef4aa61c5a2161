"""Starts the processes of a session, watches them, restarts them, and ends them.

Every process is forked from the launcher, which has loaded the codecs once. So a start or a restart
takes milliseconds. Therefore the launcher itself has one thread, and uses no shared memory.
"""

import ctypes
import errno
import gc
import os
import resource
import selectors
import signal
import socket
import traceback
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from pkgutil import resolve_name
from types import FrameType
from typing import Protocol

from kontur_av.clock import NS_PER_MS, NS_PER_S, MonotonicClock
from kontur_av.errors import ConfigError
from kontur_av.returned import PartError
from pipelines.session import session_switch
from pipelines.session.command_process import ENDING, handled
from pipelines.session.datagrams import LOOPBACK, OWN_SENDERS, family_of
from pipelines.session.kept_files import KeptOrders
from pipelines.session.page_sockets import PageListener
from pipelines.session.probe import Message
from pipelines.session.process import Collections, Context, become
from pipelines.session.setup.table import Setup
from pipelines.session.topology.rows import WATCHER_PRIORITY, ProcessRow
from pipelines.session.topology.table import Topology
from pipelines.session.topology.topics import RECORDER
from pipelines.session.verdict import ObservedTime, ProcessHealth

#: How often the session is shown, on the terminal and to the processes that follow it.
_SHOW_NS = NS_PER_S
_MESSAGE_OCTETS = 1 << 20
#: The exit status of a process whose user's part is to be fixed first.
_BROKEN = 3
_LOOK_NS = 100 * NS_PER_MS
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3


class Listener(Protocol):
    """Receives the processes' figures and their ends."""

    def handle_message(self, process: str, message: Message, now_ns: int) -> None:
        """A process has sent figures."""

    def handle_exit(self, process: str, error: str) -> None:
        """A process has ended; its counters begin at 0 in its next start.

        error: why the newest start that failed ended, in one line; "" if none has failed.
        """

    def handle_resumed(self, now_ns: int) -> None:
        """The processes are started again after a stop that was asked for."""


class MessageFeed(Protocol):
    """Makes the messages for the processes that follow the session."""

    def poll_messages(self, launcher: "Launcher", now_ns: int) -> Mapping[int, bytes]:
        """Return the messages of this second, by the pid of their receiver."""

    def handle_sent(self, pid: int) -> None:
        """The process has been sent its message. One that reads too slowly has lost it."""


@dataclass
class Child:
    """A row of the topology, and the process that runs it at present, if any."""

    row: ProcessRow
    run: Callable[..., None]
    pid: int | None = None
    pidfd: int = -1
    link: socket.socket | None = None
    restarts: int = 0
    ended_cpu_s: float = 0.0
    last_error: str = ""
    #: Whether its present start only takes the power of its device.
    takes_power: bool = False
    #: Whether the launcher has killed it.
    killed: bool = False
    #: When its present start has reported last; 0 before.
    told_ns: int = 0
    #: Whether it ran when the end of the session began.
    ran: bool = False
    #: The error that the present start has reported before its end.
    told_error: str = ""
    #: Whether it is not to run: its present start, if any, is to end.
    stopped: bool = False
    policy: session_switch.RestartPolicy = field(init=False)
    health: ProcessHealth = field(init=False)

    def __post_init__(self) -> None:
        self.policy = session_switch.RestartPolicy(self.row.stage)
        self.health = ProcessHealth(idle=self.row.priority == WATCHER_PRIORITY)

    def cpu_s(self) -> float:
        if self.pid is None:
            return self.ended_cpu_s
        try:
            fields = Path(f"/proc/{self.pid}/stat").read_text().rpartition(")")[2].split()
        except OSError:
            return self.ended_cpu_s
        return self.ended_cpu_s + (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@dataclass
class Launcher:
    """Runs `processes` of `topology` until it is told to stop.

    listener: gets the figures and ends of the processes.
    seed: of the radio's random events.
    show: called about once a second, with this launcher, to show figures to the user.
    pages: by process, where it serves browser pages.
    awaited: a process that has reported before the next one is started.
    arguments: by process, what its function takes beside the arguments of its row.
    feed: asked once a second for messages to processes that follow the session.
    """

    session: str
    topology: Topology
    processes: Sequence[ProcessRow]
    clock: MonotonicClock
    listener: Listener
    snapshots: Path | None = None
    seed: int = 0
    show: Callable[["Launcher"], None] | None = None
    pages: Mapping[str, PageListener] = field(default_factory=dict)
    awaited: str | None = None
    arguments: Mapping[str, Mapping[str, object]] = field(default_factory=dict)
    feed: MessageFeed | None = None
    children: list[Child] = field(init=False)
    started_ns: int = 0
    ended_ns: int = 0
    switch: session_switch.SessionSwitch = field(default_factory=session_switch.SessionSwitch)
    observed: ObservedTime = field(default_factory=ObservedTime)
    _collections: Collections = field(default_factory=Collections)
    _selector: selectors.BaseSelector = field(default_factory=selectors.DefaultSelector)
    _stop: bool = False
    _ending: bool = False

    def __post_init__(self) -> None:
        # Imported once, before the forks.
        self.children = [Child(row, resolve_name(row.run)) for row in self.processes]

    @property
    def setup(self) -> Setup:
        return self.topology.setup

    @property
    def seconds(self) -> float:
        end_ns = self.ended_ns or self.clock.now_ns()
        return (end_ns - self.started_ns) / NS_PER_S

    @property
    def stopped_s(self) -> list[tuple[float, float]]:
        """From when to when the session was stopped on request, in s since its start."""
        return [
            ((begin_ns - self.started_ns) / NS_PER_S, (end_ns - self.started_ns) / NS_PER_S)
            for begin_ns, end_ns in self.switch.stops_ns
        ]

    def run(self, seconds: float | None) -> None:
        """Start all processes, and return when all have ended: after `seconds`, or on a signal."""
        wake_read, wake_write = socket.socketpair()
        wake_read.setblocking(False)
        wake_write.setblocking(False)
        previous_wakeup = signal.set_wakeup_fd(wake_write.fileno())
        self._selector.register(wake_read, selectors.EVENT_READ, wake_read)
        # Present objects are never freed. Frozen, they are not walked, and their pages not copied.
        gc.collect()
        gc.freeze()
        with handled(self._handle_signal), wake_read, wake_write, self._selector:
            try:
                self.started_ns = self.clock.now_ns()
                for child in self.children:
                    self._start(child)
                    if child.row.name == self.awaited:
                        self._await(child)
                end_ns = None if seconds is None else self.started_ns + round(seconds * NS_PER_S)
                self._watch(end_ns)
                self.ended_ns = self.clock.now_ns()
                self.switch.handle_end(self.ended_ns)
            finally:
                self._end_all()
                signal.set_wakeup_fd(previous_wakeup)

    def cpu_s(self) -> dict[str, float]:
        return {child.row.name: child.cpu_s() for child in self.children}

    def _handle_signal(self, number: int, frame: FrameType | None) -> None:
        self._stop = True

    def _watch(self, end_ns: int | None) -> None:
        show_ns = self.started_ns + _SHOW_NS
        while not self._stop:
            now_ns = self.clock.now_ns()
            if end_ns is not None and now_ns >= end_ns:
                return
            if now_ns >= show_ns:
                show_ns += _SHOW_NS * ((now_ns - show_ns) // _SHOW_NS + 1)
                self._show()
                self._feed_followers(now_ns)
                self.observed.handle_second(now_ns)
                self._collections.handle_flush()
            self._follow_switch(now_ns)
            dues_ns = [show_ns, end_ns, self.switch.poll_timeout()]
            for child in self.children:
                kill_ns = child.policy.poll_kill()
                if self._is_lost(child):
                    child.health.handle_killed(hung=True)
                    self._signal(child, signal.SIGKILL)
                if kill_ns is not None and child.pid is not None:
                    if kill_ns <= now_ns:
                        self._signal(child, signal.SIGKILL)
                    else:
                        dues_ns.append(kill_ns)
                due_ns = child.policy.poll_timeout()
                if due_ns is None or not self._keeps_alive(child):
                    continue
                if due_ns <= now_ns:
                    # A start after a stop that was asked for is no restart.
                    child.restarts += not child.stopped
                    self._start(child)
                else:
                    dues_ns.append(due_ns)
            self._attend(min(due for due in dues_ns if due is not None) - self.clock.now_ns())

    def handle_order(self, order: session_switch.Order) -> None:
        """Stop all processes but those of the pages, or start them again."""
        self.switch.handle_order(order, self.clock.now_ns())

    def _handle_process_order(self, order: session_switch.ProcessOrder) -> None:
        """Stop or start a process; see `ProcessOrder`."""
        child = next((one for one in self.children if one.row.name == order.process), None)
        if child is None or child.policy.wanted is order.run:
            return
        child.policy.handle_wanted(order.run, self.clock.now_ns())
        if not order.run:
            child.stopped = True
            self._signal(child, signal.SIGTERM)

    def _is_lost(self, child: Child) -> bool:
        """Whether it hangs while its device has power."""
        if not child.row.powered or child.takes_power or child.killed or child.pid is None:
            return False
        health, at_ns = child.health, self.observed.now_ns
        told_ns = child.told_ns + self.clock.wall_offset_ns - _LOOK_NS
        unanswered = health.hangs(at_ns) and KeptOrders(self.session).stopped_at_ns > told_ns
        return health.is_lost(at_ns, unanswered=unanswered)

    def _signal(self, child: Child, number: signal.Signals) -> None:
        """Send a signal to the process, unless it is taking the power of its device."""
        if child.pid is not None and not self._takes_power(child):
            child.killed = number == signal.SIGKILL
            os.kill(child.pid, number)

    def _takes_power(self, child: Child) -> bool:
        """Whether it is taking the power of its device, and has time left for it."""
        until_ns = child.policy.poll_kill() or 0
        return child.takes_power and child.pid is not None and self.clock.now_ns() < until_ns

    def _keeps_alive(self, child: Child) -> bool:
        return (
            self.switch.activity is session_switch.Activity.RUNNING or child.row.name in self.pages
        )

    def _follow_switch(self, now_ns: int) -> None:
        self.switch.handle_timeout(now_ns)
        if all(child.pid is None for child in self.children if child.row.name not in self.pages):
            self.switch.handle_all_ended(now_ns)
        while (action := self.switch.next_event()) is not None:
            if action is session_switch.SwitchAction.START:
                self.listener.handle_resumed(now_ns)
                continue  # `_watch` starts them in order
            number = signal.SIGTERM if action is session_switch.SwitchAction.END else signal.SIGKILL
            for child in self.children:
                if child.row.name not in self.pages:
                    child.stopped = True
                    self._signal(child, number)

    def _feed_followers(self, now_ns: int) -> None:
        if self.feed is None:
            return
        messages = self.feed.poll_messages(self, now_ns)
        links = {child.pid: child.link for child in self.children}
        for pid, message in messages.items():
            # A process that does not read must not hold up the launcher.
            with suppress(OSError):
                if (link := links[pid]) is not None:
                    link.send(message, socket.MSG_DONTWAIT)
                    self.feed.handle_sent(pid)

    def _show(self) -> None:
        if self.show is None:
            return
        try:
            self.show(self)
        except BrokenPipeError:
            self._stop = True  # the reader, such as head(1), has ended
        except OSError:
            # A closed terminal, whose signal follows, or a full disk, which must not end a session.
            # `show` also tells a keeper of versions that the session lives, so go on calling it.
            pass

    def _attend(self, timeout_ns: int) -> None:
        for key, _ in self._selector.select(max(0, timeout_ns) / NS_PER_S):
            if isinstance(key.data, Child):
                child = key.data
                if key.fileobj is child.link:
                    self._receive(child)
                elif child.pid is not None:
                    self._handle_end(child)
            else:
                key.data.recv(64)

    def _receive(self, child: Child) -> None:
        assert child.link is not None
        while True:
            try:
                data = child.link.recv(_MESSAGE_OCTETS)
            except BlockingIOError:
                return
            except OSError:
                data = b""
            if not data:
                self._close_link(child)
                return
            now_ns = self.clock.now_ns()
            if not self._ending:
                running = sum(one.pid is not None for one in self.children)
                self.observed.handle_report(now_ns, running)
            child.health.handle_report(self.observed.now_ns)
            message = Message.unpack(data)
            child.told_ns = now_ns
            child.told_error = message.last_error or child.told_error
            self.listener.handle_message(child.row.name, message, now_ns)
            for order in message.orders:
                if isinstance(order, session_switch.ProcessOrder):
                    self._handle_process_order(order)
                elif child.row.name in self.pages:
                    self.switch.handle_order(order, now_ns)

    def _start(self, child: Child) -> None:
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        for end in (ours, theirs):
            end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _MESSAGE_OCTETS)
        # Until the child has its own handler, a SIGTERM must wait: ours would handle it.
        signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)
        launcher = os.getpid()
        pid = os.fork()
        if pid == 0:
            # No exception may leave this block: the callers would end the siblings.
            code = 1
            try:
                ours.close()
                code = self._become_child(child, theirs, launcher)
            finally:
                os._exit(code)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDING)
        theirs.close()
        ours.setblocking(False)
        child.pid, child.link, child.stopped = pid, ours, False
        child.pidfd = os.pidfd_open(pid)
        child.told_ns, child.killed = 0, False
        child.policy.handle_start(self.clock.now_ns())
        child.health.handle_start(self.observed.now_ns)
        self._selector.register(ours, selectors.EVENT_READ, child)
        self._selector.register(child.pidfd, selectors.EVENT_READ, child)

    def _become_child(self, child: Child, link: socket.socket, launcher: int) -> int:
        context = Context(
            session=self.session,
            topology=self.topology,
            clock=self.clock,
            link=link,
            snapshots=self.snapshots,
            started_ns=self.started_ns,
            seed=self.seed,
            pages={name: page for name, page in self.pages.items() if name == child.row.name},
            takes_power=child.takes_power,
        )
        try:
            signal.set_wakeup_fd(-1)
            # Only the launcher may hold the other ends; else nobody would notice when they close.
            for key in list(self._selector.get_map().values()):
                fd = key.fd
                if fd != link.fileno():
                    os.close(fd)
            for name, page in self.pages.items():
                if name not in context.pages:
                    page.socket.close()
            become(child.row, context)
            if os.getppid() != launcher:
                return 1  # the launcher was killed before `become`
            signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDING)
            child.run(context, **child.row.arguments, **self.arguments.get(child.row.name, {}))
            context.flush(self.clock.now_ns())
        except BaseException as error:
            context.probe.message.last_error = _one_line(error)
            try:
                context.flush(self.clock.now_ns())
            except Exception:
                # Filling in the counters may have failed itself.
                context.send_metrics(self.clock.now_ns())
            return _BROKEN if isinstance(error, PartError) else 1
        return 0

    def _handle_end(self, child: Child) -> None:
        assert child.pid is not None
        if child.link is not None:
            self._receive(child)
        self._close_link(child)
        self._selector.unregister(child.pidfd)
        os.close(child.pidfd)
        _, status, usage = os.wait4(child.pid, 0)
        child.pid = None
        child.ended_cpu_s += usage.ru_utime + usage.ru_stime
        signaled, now_ns = os.WIFSIGNALED(status), self.clock.now_ns()
        error = child.told_error or session_switch.NO_REASON
        if signaled:
            error = f"ended by {_signal_name(os.WTERMSIG(status))}"
        # An end that was asked for is no error.
        asked = self._ending or child.stopped
        if not asked:
            child.last_error = error
            child.health.handle_end(error, self.observed.now_ns)
        child.told_error = ""
        self.listener.handle_exit(child.row.name, child.last_error)
        if child.stopped:
            child.policy.handle_stop(now_ns)
        else:
            broken = child.row.powered if signaled else os.WEXITSTATUS(status) == _BROKEN
            child.policy.handle_end(now_ns, broken=broken)
        if child.takes_power:
            child.takes_power = False
            child.health.handle_power_off(error if status else "")
        elif child.policy.hopeless or (child.row.powered and status and (asked or child.killed)):
            self._give_up(child, error)

    def _give_up(self, child: Child, error: str) -> None:
        """Give a process no further life but one that takes the power of its device."""
        child.health.handle_given_up(error, powered=child.row.powered)
        child.takes_power = child.row.powered
        if child.takes_power:
            self._start(child)
        child.stopped = True
        child.policy.handle_wanted(False, self.clock.now_ns(), session_switch.POWER_OFF_NS)

    def _close_link(self, child: Child) -> None:
        if child.link is not None:
            self._selector.unregister(child.link)
            child.link.close()
            child.link = None

    def _await(self, child: Child) -> None:
        """Wait until a process has reported, or does not within its time."""
        until_ns = self.clock.now_ns() + session_switch.TIMEOUT_NS
        while child.pid is not None and not child.told_ns and not self._stop:
            left_ns = until_ns - self.clock.now_ns()
            if left_ns <= 0:
                return
            self._attend(left_ns)

    def _end_all(self) -> None:
        """End all processes; the recorder last, so that it hears the last of the others."""
        self._ending = True
        for child in self.children:
            child.ran = child.pid is not None
        self._end([child for child in self.children if child.row.name != RECORDER])
        self._feed_followers(self.clock.now_ns())
        self._end(self.children)

    def _end(self, children: Sequence[Child]) -> None:
        """End these by SIGTERM, and those that remain by SIGKILL."""
        for number in (signal.SIGTERM, signal.SIGKILL):
            for child in children:
                if number == signal.SIGKILL and child.pid is not None and not child.takes_power:
                    child.health.handle_killed()
                self._signal(child, number)
            left_ns = session_switch.TIMEOUT_NS
            while any(self._takes_power(child) for child in children) or (
                left_ns > 0 and any(child.pid is not None for child in children)
            ):
                began_ns = self.clock.now_ns()
                self._attend(_LOOK_NS)
                # A machine that stalls leaves them as much time as before.
                left_ns -= min(self.clock.now_ns() - began_ns, 2 * _LOOK_NS)


def _one_line(error: BaseException) -> str:
    if isinstance(error, PartError):
        return str(error)
    where = traceback.extract_tb(error.__traceback__)[-1]
    kind = type(error).__name__
    return f"{kind}: {error} ({Path(where.filename).name}:{where.lineno})"


def _signal_name(number: int) -> str:
    if number == signal.SIGBUS:
        return session_switch.NO_ROOM
    try:
        return signal.Signals(number).name
    except ValueError:  # most real-time signals have no name
        return f"signal {number}"


def hold_ports(topology: Topology) -> socket.socket:
    """Hold the launcher's port and check the others. Raises ConfigError if one is busy.

    The launcher's own port is held while the returned socket is open. So of two sessions that start
    at the same moment only one gets it.
    """
    held = hold_port(topology.launcher_port)
    for port in topology.ports_here:
        if port != topology.launcher_port:
            hold_port(port).close()
            hold_port(port, OWN_SENDERS).close()
    return held


def hold_port(port: int, address: str = LOOPBACK) -> socket.socket:
    """Return a socket that holds the UDP port while it is open; ConfigError if it is busy."""
    udp = socket.socket(family_of(address), socket.SOCK_DGRAM)
    try:
        udp.bind((address, port))
    except OSError as error:
        udp.close()
        if error.errno == errno.EADDRNOTAVAIL:
            raise ConfigError(
                f"{address} is no address of this machine: take one of its own"
            ) from None
        raise ConfigError(
            f"UDP port {port} is busy: end the program that has it (another session?), "
            "or choose other ports with --base-port"
        ) from None
    return udp


def load_libraries() -> None:
    """Load the libraries of the processes once, before they are forked."""
    import av  # noqa: F401
    import cv2

    import kontur_av.codecs.opus  # noqa: F401
    from kontur_av.codecs import libopus

    with suppress(ImportError):
        import iceoryx2  # noqa: F401
    libopus.opuslib()
    cv2.setNumThreads(1)
    keep_memory()


def keep_memory() -> None:
    """Make the C library keep freed memory, so that each picture's memory is not mapped anew."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:  # glibc
        mallopt(_M_MMAP_THRESHOLD, 1 << 25)
        mallopt(_M_TRIM_THRESHOLD, 1 << 28)


def launcher_cpu_s() -> float:
    """Return the CPU seconds of the launcher itself, imports included."""
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime
