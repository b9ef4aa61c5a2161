"""A segment's gateway process: UDP ports on one side, one transfer frame a slot on the other.

A slot, in the order in which things happen: a little before its deadline the process wakes, takes
what has come to the flows' ports, and waits for the instant itself; then it fetches the newest
haptic sample, packs the frame and sends it. What comes by radio goes on at once, at any time, and
after that there is the rest of the slot for figures.
"""

import secrets
import select
from contextlib import ExitStack

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.media import CaptureStamp
from pipelines.cores.ends import make_gateway
from pipelines.runtime.datagrams import EndAddresses, Inlet, Outlet, open_peer, outlet, receive
from pipelines.runtime.margin import Margin
from pipelines.runtime.process import LOOPBACK, PATIENCE_NS, Context, Segment
from pipelines.setup.names import BACKLOG, backlog_topic
from pipelines.setup.table import Setup
from telepresence.haptics.schedule import PeriodicSchedule
from telepresence.link.flows import Level
from telepresence.link.frame import MAX_PACKET_OCTETS
from telepresence.link.gateway import Gateway
from telepresence.link.receiver import HapticReceived, PacketReceived

#: A burst larger than this in one slot waits in the socket for the next one.
_MOST_DATAGRAMS = 64
#: How often, at the most, the senders are told what waits.
_TELL_NS = 4 * NS_PER_MS
#: What is freed is told in steps of this, rounded down: not every slot is worth a message.
_FREED_GRAIN_BPS = 1_000
#: What figures take at the worst: they are put together when so much of a slot is left.
_FIGURES_NS = NS_PER_MS // 2

_ON_THIS_MACHINE = EndAddresses()


class _Ports:
    """The sockets of one end, and what strangers have sent to them."""

    def __init__(
        self, setup: Setup, segment: Segment, gateway: Gateway, addresses: EndAddresses
    ) -> None:
        ports = setup.ports
        if segment is Segment.GROUND:
            radio, peer = ports.ground_radio, ports.space_radio
            haptic_entry, haptic_exit = ports.ground_haptic, ports.robot
        else:
            radio, peer = ports.space_radio, ports.ground_radio
            haptic_entry, haptic_exit = ports.space_haptic, ports.joystick

        def entry(port: int) -> Inlet:
            return Inlet((addresses.apps_bind, port), addresses.apps)

        def exit_to(port: int) -> Outlet:
            return outlet(addresses.apps_bind, (addresses.apps, port))

        self.radio, self._not_peer = open_peer(
            (addresses.bind, radio), addresses.peer or (LOOPBACK, peer)
        )
        self.to_peer = Outlet(self.radio)
        self.haptic, self.to_haptic_end = entry(haptic_entry), exit_to(haptic_exit)
        self.entries = {flow.name: entry(ports.entry(flow.name)) for flow in gateway.sender.flows}
        self.exits = {flow.name: exit_to(ports.exit(flow.name)) for flow in gateway.receiver.flows}
        self._radio_strangers = 0
        self.local = select.epoll()
        self._by_fd = {inlet.udp.fileno(): name for name, inlet in self.entries.items()}
        for fd in (*self._by_fd, self._not_peer.fileno()):
            self.local.register(fd, select.EPOLLIN)

    def fetch_local(self, ready: list[tuple[int, int]], gateway: Gateway, now_ns: int) -> None:
        """Take what waits in the flows' ports, and throw away what strangers sent by radio.

        ready: what `local.poll(0)` has said: one question for all of them; to be told by an empty
        socket that it is empty costs more.
        """
        by_fd, entries = self._by_fd, self.entries
        taken = 0
        while ready and taken < _MOST_DATAGRAMS:
            taken += len(ready)
            for fd, _events in ready:
                flow = by_fd.get(fd)
                if flow is None:
                    self._radio_strangers += receive(self._not_peer, 1) is not None
                    continue
                datagram = entries[flow].receive(MAX_PACKET_OCTETS + 1)
                if datagram is not None:
                    gateway.handle_datagram(flow, datagram, now_ns)
            ready = self.local.poll(0)

    def strangers(self) -> dict[str, int]:
        """Datagrams of strangers by port."""
        counts = {"radio": self._radio_strangers, "haptic": self.haptic.strangers}
        return counts | {name: inlet.strangers for name, inlet in self.entries.items()}

    def unsent(self) -> int:
        """Frames that the system did not take."""
        return self.to_peer.failed


def run_gateway(
    context: Context,
    *,
    segment: Segment,
    addresses: EndAddresses = _ON_THIS_MACHINE,
    tell_backlog: bool = True,
) -> None:
    """Bind the flows' ports, and exchange one frame a slot with the other segment.

    tell_backlog: tell the session's video sender through shared memory how much video waits.
    """
    clock, probe = context.clock, context.probe
    gateway = make_gateway(
        context.setup,
        ground=segment is Segment.GROUND,
        life=1 + secrets.randbelow(0xFFFF),
        seed=context.seed,
        epoch_ns=context.started_ns,
        now_ns=clock.now_ns(),
    )
    ports = _Ports(context.setup, segment, gateway, addresses)
    slot_ns = gateway.sender.profile.slot_ns
    schedule = PeriodicSchedule(start_ns=context.first_deadline_ns(slot_ns), period_ns=slot_ns)
    margin = Margin()
    to_listen = [ports.radio]
    crowd = select.epoll()
    crowd.register(ports.haptic.udp.fileno(), select.EPOLLIN)
    # Looked up once: what follows runs a thousand times a second.
    clock_ns, handle_wakeup, sleep = clock.now_ns, schedule.handle_wakeup, select.select
    handle_haptic, handle_radio = gateway.handle_haptic, gateway.handle_radio
    handle_slot, poll_radio, radio_due_ns = (
        gateway.handle_slot,
        gateway.poll_transmit,
        gateway.poll_timeout,
    )
    next_event, fetch_local, learn_margin = (
        gateway.next_event,
        ports.fetch_local,
        margin.handle_wakeup,
    )
    radio_octets = gateway.receiver.profile.frame_octets + 1
    haptic_octets = gateway.sender.profile.insert_octets + 1
    from_radio, to_peer, exits = ports.radio, ports.to_peer.send, ports.exits
    poll_local = ports.local.poll
    fetch_haptic, more_haptic = ports.haptic.receive, crowd.poll
    to_haptic_end = ports.to_haptic_end.send
    supervisor = gateway.supervisor
    waiting_octets = gateway.sender.waiting_octets
    add_lateness, add_sending = probe.rows("lateness").append, probe.rows("sending").append

    def fill() -> None:
        probe.total("slips", schedule.slips)
        probe.total("cycles", schedule.cycles)
        probe.total("unsent", ports.unsent())
        for name, count in ports.strangers().items():
            if count:
                probe.total(f"strangers_{name}", count)
        probe.gauge("link", gateway.report(clock_ns()))

    def fetch_radio(now_ns: int) -> None:
        # One a wake-up: there is hardly ever a second, and asking for it costs a system call.
        frame = receive(from_radio, radio_octets)
        if frame is not None:
            handle_radio(frame, now_ns)
        while (event := next_event()) is not None:
            if isinstance(event, HapticReceived):
                to_haptic_end(event.sample)
            elif isinstance(event, PacketReceived):
                exits[event.flow.name].send(event.data)

    def fetch_newer(now_ns: int) -> None:
        for _ in range(_MOST_DATAGRAMS):
            if not more_haptic(0):
                return
            sample = fetch_haptic(haptic_octets)
            if sample is not None:
                handle_haptic(sample, now_ns)

    def send_due(now_ns: int) -> None:
        while (frame := poll_radio(now_ns)) is not None:
            to_peer(frame)

    context.on_flush(fill)
    with ExitStack() as stack:
        writer = None
        if tell_backlog:
            writer = stack.enter_context(context.open_bus()).writer(
                backlog_topic(gateway.sender.profile.name), max_octets=BACKLOG.size, wake=False
            )
        told = -1, 0, False, 0
        figures_ns = tell_ns = 0
        deadline_ns = schedule.next_deadline_ns
        wake_ns = alarm_ns = deadline_ns
        while not context.stopping:
            wait_ns = alarm_ns - clock_ns()
            # Not epoll, whose timeouts have whole milliseconds; a timerfd costs more than it gains.
            heard = sleep(to_listen, (), (), wait_ns / NS_PER_S if wait_ns > 0 else 0)[0]
            now_ns = clock_ns()
            if heard:
                fetch_radio(now_ns)
                if now_ns >= figures_ns and deadline_ns - now_ns > _FIGURES_NS:
                    figures_ns = now_ns + PATIENCE_NS
                    context.tick(now_ns)
            if now_ns < alarm_ns:
                continue
            if now_ns < wake_ns:
                send_due(now_ns)
            else:
                ready = poll_local(0)
                if ready:
                    fetch_local(ready, gateway, now_ns)
                now_ns = clock_ns()
                learn_margin(now_ns - wake_ns)
                while now_ns < deadline_ns:
                    now_ns = clock_ns()
                add_lateness(handle_wakeup(now_ns))
                # Only the newest sample counts; there is nearly always one, hardly ever a second.
                sample = fetch_haptic(haptic_octets)
                if sample is not None:
                    handle_haptic(sample, now_ns)
                    fetch_newer(now_ns)
                handle_slot(now_ns)
                send_due(now_ns)
                add_sending(clock_ns() - deadline_ns)
                deadline_ns = schedule.next_deadline_ns
                wake_ns = deadline_ns - margin.ns
                if writer is not None and now_ns >= tell_ns:
                    waiting = (
                        waiting_octets(Level.VIDEO),
                        gateway.contacts,
                        supervisor.signal,
                        gateway.freed_bps // _FREED_GRAIN_BPS * _FREED_GRAIN_BPS,
                    )
                    if waiting != told:
                        told, tell_ns = waiting, now_ns + _TELL_NS
                        writer.publish_octets(
                            BACKLOG.pack(*told), CaptureStamp(now_ns, 0, "gateway")
                        )
                if now_ns >= figures_ns + PATIENCE_NS:
                    # Nothing comes by radio.
                    figures_ns = now_ns + PATIENCE_NS
                    context.tick(now_ns)
            due_ns = radio_due_ns()
            alarm_ns = wake_ns if due_ns is None or due_ns > wake_ns else due_ns
