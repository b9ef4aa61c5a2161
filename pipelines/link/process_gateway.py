"""A segment's gateway process: UDP ports on one side, one transfer frame a slot on the other.

`GatewayEnd` and its `GatewaySlots` decide what happens when. This module has the sockets, the clock
and the sleep.
"""

import secrets
import select
import socket
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from functools import partial
from typing import Final

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.topics.bus import TopicBus
from pipelines.link.gateway_end import GatewayEnd, path_needs
from pipelines.link.link_metrics import SocketMetrics, gateway_topic, link_state_topic, link_values
from pipelines.link.own_ends import PeerPlan, PeerSocket, make_path
from pipelines.session.datagrams import (
    LOOPBACK,
    OWN_SENDERS,
    EndAddresses,
    Inlet,
    Outlet,
    OwnInlet,
    OwnOutlet,
    listen_own,
    listen_to,
    open_peer,
    outlet,
    receive,
)
from pipelines.session.process import Context
from pipelines.session.session_metrics import LatenessRow, SendingRow
from pipelines.session.setup.segments import Segment
from pipelines.session.topic_ends import TopicReader, TopicWriter
from pipelines.session.topology.rows import Frames
from pipelines.session.topology.streams import TELECOMMAND, TELEMETRY
from pipelines.session.topology.table import Topology
from pipelines.session.training import TRAINER_TOPIC, Exercises
from telepresence.link.flows import HapticReceived, PacketReceived
from telepresence.link.frame import MAX_PACKET_OCTETS
from telepresence.link.gateway import Backlog, Gateway
from telepresence.link.link_metrics import GatewayMetrics
from telepresence.link.path.following import NO_VIDEO

#: Frames of this time are one sample.
_BATCH_NS: Final = 20 * NS_PER_MS
#: Figures are made, and readers looked for, once in this many batches.
_SELDOM: Final = 5
#: Room for most samples; a topic makes more for a larger one.
_METRICS_OCTETS, _FRAMES_OCTETS = 4 << 10, 16 << 10


class LinkTopics:
    """Call `handle_time` at `due_ns`, when most of a slot is left.

    due_ns: the instant of the next call.
    """

    def __init__(
        self, bus: TopicBus, topology: Topology, segment: Segment, gateway: Gateway
    ) -> None:
        self.due_ns = 0
        self._gateway = gateway
        out, back = topology.link(segment.transmits), topology.link(segment.transmits.opposite)
        self._metrics = TopicWriter(bus, gateway_topic(segment), octets=_METRICS_OCTETS)
        self._sent = TopicWriter(bus, out.sent_frames_topic, octets=_FRAMES_OCTETS)
        self._received = TopicWriter(bus, back.received_frames_topic, octets=_FRAMES_OCTETS)
        self._state = TopicWriter(bus, link_state_topic(segment))
        # The first call looks for readers.
        self._batches = _SELDOM - 1

    def handle_time(self, now_ns: int) -> None:
        self.due_ns = now_ns + _BATCH_NS
        gateway = self._gateway
        if gateway.frames_sent:
            self._sent.publish(gateway.frames_sent, now_ns)
            gateway.frames_sent = []
        if gateway.frames_received:
            self._received.publish(gateway.frames_received, now_ns)
            gateway.frames_received = []
        self._batches += 1
        if self._batches % _SELDOM:
            return
        gateway.frames_sent = _kept(gateway.frames_sent, self._sent)
        gateway.frames_received = _kept(gateway.frames_received, self._received)
        if self._metrics.has_readers():
            self._metrics.publish(gateway.report(now_ns), now_ns)

    def handle_metrics(self, metrics: GatewayMetrics, now_ns: int) -> None:
        """Publish for telemetry what was counted for the report anyway, twice a second."""
        self._state.publish(link_values(metrics), now_ns)


def _kept(
    frames: list[tuple[int, bytes]] | None, topic: TopicWriter[Frames]
) -> list[tuple[int, bytes]] | None:
    if not topic.has_readers():
        return None
    return [] if frames is None else frames


class GatewayPorts:
    """The sockets of one end, with counts of unknown senders' datagrams.

    session: whose own processes alone use the channels, but for maintenance; None: any program of
    the host.
    peer: the socket to the other end on another machine; None: it is on this one.
    radio: becomes readable when a frame may have come.
    frame: returns the next frame of the peer, or None.
    to_peer: sends a frame.
    """

    def __init__(
        self,
        topology: Topology,
        segment: Segment,
        gateway: Gateway,
        addresses: EndAddresses,
        peer: PeerSocket | None,
        session: str | None,
    ) -> None:
        (haptic_out,) = (row for row in topology.haptics if row.direction is segment.transmits)
        (haptic_in,) = (row for row in topology.haptics if row is not haptic_out)

        moving = {TELECOMMAND, TELEMETRY, haptic_out.name, haptic_in.name}
        own = {row.name for row in topology.streams if row.sender is not None}

        def entry(name: str, port: int) -> Inlet | OwnInlet:
            if session is None or name not in own:
                return Inlet((addresses.apps_bind, port), addresses.apps)
            if name in moving:
                return OwnInlet(listen_own(session, port))
            return OwnInlet(listen_to((LOOPBACK, port), (OWN_SENDERS, port)))

        def exit_to(name: str, port: int) -> Outlet | OwnOutlet:
            # Past the gateways a sender has this port of ours, and nothing comes here.
            if session is None or name not in own or topology.options.bypass:
                return outlet(addresses.apps_bind, (addresses.apps, port))
            if name in moving:
                return OwnOutlet(session, port)
            return outlet(OWN_SENDERS, (LOOPBACK, port), port=port)

        self.radio: socket.socket
        self.frame: Callable[[], bytes | None]
        self.to_peer: Outlet | PeerSocket
        self._not_peer: socket.socket | None = None
        if peer is None:
            here, there = topology.radio_port(segment), topology.radio_port(segment.peer)
            self.radio, self._not_peer = open_peer((LOOPBACK, here), (LOOPBACK, there))
            frame_octets = gateway.receiver.profile.frame_octets
            self.frame = partial(receive, self.radio, frame_octets + 1)
            self.to_peer = Outlet(self.radio)
        else:
            self.radio, self.frame, self.to_peer = peer.udp, peer.frame, peer
        self._haptic_octets = gateway.sender.profile.insert_octets + 1
        self._haptic = entry(haptic_out.name, haptic_out.entry_port)
        self._fetch_haptic = self._haptic.receive
        more_haptic = select.epoll()
        more_haptic.register(self._haptic.udp.fileno(), select.EPOLLIN)
        self._more_haptic = more_haptic.poll
        self.to_haptic_end = exit_to(haptic_in.name, haptic_in.exit_port)
        self._entries = {
            flow.name: entry(flow.name, topology.stream(flow.name).entry_port)
            for flow in gateway.sender.flows
        }
        self.exits = {
            flow.name: exit_to(flow.name, topology.exit_port(flow.name))
            for flow in gateway.receiver.flows
        }
        self._radio_unknown_senders = 0
        self._flow_by_fd = {inlet.udp.fileno(): name for name, inlet in self._entries.items()}
        flow_ports = select.epoll()
        for fd in self._flow_by_fd:
            flow_ports.register(fd, select.EPOLLIN)
        if self._not_peer is not None:
            flow_ports.register(self._not_peer.fileno(), select.EPOLLIN)
        #: Returns the flows' ports with datagrams. One epoll(7) costs less than a read of each
        #: empty socket.
        self.poll_flows = flow_ports.poll

    def datagrams(self, ready: list[tuple[int, int]]) -> Iterator[tuple[str, bytes | None]]:
        """Yield (flow, datagram) of the flows' ports, one of each port in turn.

        ready: from `poll_flows`. An unknown sender's datagram is None.
        """
        flow_by_fd, entries = self._flow_by_fd, self._entries
        while ready:
            for fd, _events in ready:
                flow = flow_by_fd.get(fd)
                if flow is not None:
                    yield flow, entries[flow].receive(MAX_PACKET_OCTETS + 1)
                elif self._not_peer is not None:
                    self._radio_unknown_senders += receive(self._not_peer, 1) is not None
                    yield "radio", None
            ready = self.poll_flows(0)

    def samples(self) -> Iterable[bytes | None]:
        """Return the datagrams of the haptic port; an unknown sender's is None."""
        sample = self._fetch_haptic(self._haptic_octets)
        # Most slots have exactly one.
        if sample is None:
            return ()
        return self._all_samples(sample) if self._more_haptic(0) else (sample,)

    def _all_samples(self, first: bytes) -> Iterator[bytes | None]:
        yield first
        while self._more_haptic(0):
            yield self._fetch_haptic(self._haptic_octets)

    def unknown_senders(self) -> dict[str, int]:
        """Return the number of unknown senders' datagrams by port, if there were any.

        A port is named by what it receives: "radio", "haptic", or the name of a flow.
        """
        counts = {"radio": self._radio_unknown_senders, "haptic": self._haptic.unknown_senders}
        counts |= {name: inlet.unknown_senders for name, inlet in self._entries.items()}
        return {name: count for name, count in sorted(counts.items()) if count}


_ON_THIS_MACHINE = EndAddresses()


def run_gateway(
    context: Context,
    *,
    segment: Segment,
    addresses: EndAddresses = _ON_THIS_MACHINE,
    peer: PeerPlan | None = None,
    publish_backlog: bool = True,
    radio_after_ns: int = 0,
) -> None:
    """Bind the flows' ports, and exchange one frame a slot with the other segment.

    peer: how to reach the other segment on another machine; None: it is on this one.
    publish_backlog: write to shared memory how much video waits, and what a recorder
        wants to know.
    radio_after_ns: the radio's time 0, after the start of the session.

    The signal is lost when a trainer says so. With `peer`, the radio of both directions is then
    here, because it has one time only.
    """
    clock, topology = context.clock, context.topology
    trainer = TRAINER_TOPIC in topology.reads(topology.gateway(segment).name)
    end = GatewayEnd(
        topology,
        segment,
        context.probe,
        boot_id=1 + secrets.randbelow(0xFFFF),
        secret=secrets.randbits(128),
        seed=context.seed,
        epoch_ns=context.started_ns + radio_after_ns,
        now_ns=clock.now_ns(),
        first_ns=context.first_deadline_ns(topology.link(segment.transmits).profile.slot_ns),
        told_offset_ns=None if peer is None else clock.wall_offset_ns,
        radio_both_ways=peer is not None and trainer,
    )
    path = None
    if peer is not None:
        way_out, way_in = end.gateway.sender.profile, end.gateway.receiver.profile
        # Other programs' video follows nothing.
        needs = path_needs(topology, segment.transmits) if publish_backlog else NO_VIDEO
        core = make_path(peer, way_out, way_in, clock.now_ns(), needs)
        path = PeerSocket(core, peer, clock.now_ns)
    session = context.session if publish_backlog else None
    ports = GatewayPorts(topology, segment, end.gateway, addresses, path, session)
    loop = _GatewayLoop(context, end, ports, path)
    with ExitStack() as stack:
        if publish_backlog:
            bus = stack.enter_context(context.open_bus())
            backlog_topic = topology.link(segment.transmits).backlog_topic
            loop.backlogs = TopicWriter(bus, backlog_topic)
            loop.topics = LinkTopics(bus, topology, segment, end.gateway)
            if trainer:
                loop.exercises = TopicReader(bus, TRAINER_TOPIC)
        loop.run()
        # The last figures are told when the topics are closed.
        loop.topics = None


class _GatewayLoop:
    """Sleeps, and does one step of `end` after the other.

    backlogs, topics, exercises: what is told to the session, and what a trainer says.
    """

    def __init__(
        self, context: Context, end: GatewayEnd, ports: GatewayPorts, path: PeerSocket | None
    ) -> None:
        self._context, self._end, self._ports, self._path = context, end, ports, path
        self._slots, self._clock_ns = end.slots, context.clock.now_ns
        self._to_haptic_end = ports.to_haptic_end.send
        self.backlogs: TopicWriter[Backlog] | None = None
        self.topics: LinkTopics | None = None
        self.exercises: TopicReader[Exercises] | None = None
        # Lists, because an array checks the type of each number.
        self._lateness: list[int] = []
        self._sending: list[int] = []
        context.on_flush(self._publish)

    def run(self) -> None:
        # Looked up once: what follows runs a thousand times a second.
        context, clock_ns, sleep = self._context, self._clock_ns, select.select
        end, slots = self._end, self._slots
        poll_timeout, handle_time = end.poll_timeout, end.handle_time
        poll_radio, to_peer = end.poll_transmit, self._ports.to_peer.send
        to_listen = [self._ports.radio]
        alarm_ns = poll_timeout()
        while not context.stopping:
            wait_ns = alarm_ns - clock_ns()
            # Not epoll, whose timeouts have whole milliseconds; a timerfd costs more than it gains.
            heard = sleep(to_listen, (), (), wait_ns / NS_PER_S if wait_ns > 0 else 0)[0]
            now_ns = clock_ns()
            if heard:
                self._fetch_frame(now_ns)
            if handle_time(now_ns):
                self._deliver()
                alarm_ns = poll_timeout()
            if now_ns < alarm_ns:
                continue
            deadline_ns = slots.deadline_ns
            slot = now_ns >= deadline_ns
            if slot:
                now_ns = self._run_slot(now_ns)
            while (frame := poll_radio(now_ns)) is not None:
                to_peer(frame)
            if slot:
                self._sending.append(clock_ns() - deadline_ns)
                self._use_rest(now_ns)
            alarm_ns = poll_timeout()

    def _fetch_frame(self, now_ns: int) -> None:
        # One datagram a time: a second one is rare, and asking for it costs a system call.
        frame, path = self._ports.frame(), self._path
        if frame is None:
            return
        self._end.handle_frame(frame, now_ns)
        while path is not None and (frame := path.next_frame()) is not None:
            self._end.handle_frame(frame, now_ns)
        self._deliver()
        slots = self._slots
        if now_ns >= slots.metrics_ns and slots.poll_metrics(now_ns, heard=True):
            self._context.tick(now_ns)

    def _deliver(self) -> None:
        """What the other segment sent goes to the ports where it comes out."""
        next_event, exits = self._end.next_event, self._ports.exits
        while (event := next_event()) is not None:
            if isinstance(event, HapticReceived):
                self._to_haptic_end(event.sample)
            elif isinstance(event, PacketReceived):
                exits[event.flow.name].send(event.data)

    def _run_slot(self, now_ns: int) -> int:
        """Fill a frame at its deadline; return the instant."""
        slots, ports, clock_ns = self._slots, self._ports, self._clock_ns
        if ready := ports.poll_flows(0):
            slots.handle_datagrams(ports.datagrams(ready), now_ns)
            now_ns = clock_ns()
        self._lateness.append(slots.handle_slot(ports.samples(), now_ns))
        return now_ns

    def _use_rest(self, now_ns: int) -> None:
        """Do what has most of a slot left, right after the frame was sent."""
        slots = self._slots
        path = self._path
        if path is not None:
            worked = path.work(slots.deadline_ns)
            self._end.gateway.handle_path(path.core.allowed)
            if worked:
                # What else can wait finds a slot of its own.
                return
        if self.backlogs is not None and (backlog := slots.poll_backlog()) is not None:
            self.backlogs.publish(backlog, now_ns)
        if now_ns >= slots.metrics_ns and slots.poll_metrics(now_ns, heard=False):
            self._context.tick(now_ns)
        # On one machine the peer's slot is at the same time, so its frame is most often here by
        # now. To read in vain costs less than to ask.
        self._fetch_frame(self._clock_ns())
        if self.topics is not None and now_ns >= self.topics.due_ns:
            self.topics.handle_time(now_ns)
            if self.exercises is not None and (found := self.exercises.changed()) is not None:
                self._end.handle_exercises(found, now_ns)

    def _publish(self) -> None:
        probe, now_ns = self._context.probe, self._clock_ns()
        for kind, instants in ((LatenessRow, self._lateness), (SendingRow, self._sending)):
            probe.series(kind).extend_column(instants)
            instants.clear()
        ports = self._ports
        refused = ports.to_peer.failed
        probe.publish(SocketMetrics(unsent=refused, unknown_senders=ports.unknown_senders()))
        self._end.handle_refused(refused, ports.to_peer.why, now_ns)
        path = None if self._path is None else self._path.report()
        metrics = self._end.publish(now_ns, path)
        if self.topics is not None:
            self.topics.handle_metrics(metrics, now_ns)
