"""A segment's gateway process: UDP ports on one side, one transfer frame a slot on the other.

`GatewayEnd` and its `GatewaySlots` decide what happens when. This module has the sockets, the clock
and the sleep.
"""

import secrets
import select
from collections.abc import Callable
from contextlib import ExitStack

from kontur_av.clock import NS_PER_S
from kontur_av.media import CaptureStamp
from kontur_av.topics.bus import TopicBus
from pipelines.link.figures import SocketFigures
from pipelines.link.gateway_end import GatewayEnd
from pipelines.link.gateway_ports import GatewayPorts
from pipelines.link.link_topics import LinkTopics
from pipelines.link.peer_socket import PeerPlan, PeerSocket, make_path
from pipelines.session.datagrams import EndAddresses
from pipelines.session.process import Context
from pipelines.session.rows import LatenessRow, SendingRow
from pipelines.session.topic_ends import new_exercises
from pipelines.session.topology import TRAINER_TOPIC, Segment
from pipelines.session.training import Exercises
from telepresence.link.backlog import BACKLOG_OCTETS, Backlog
from telepresence.link.flows import HapticReceived, PacketReceived

_ON_THIS_MACHINE = EndAddresses()


def run_gateway(
    context: Context,
    *,
    segment: Segment,
    addresses: EndAddresses = _ON_THIS_MACHINE,
    peer: PeerPlan | None = None,
    tell_backlog: bool = True,
    radio_after_ns: int = 0,
) -> None:
    """Bind the flows' ports, and exchange one frame a slot with the other segment.

    peer: how to reach the other segment on another machine; None: it is on this one.
    tell_backlog: tell the session through shared memory how much video waits, and what a recorder
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
        life=1 + secrets.randbelow(0xFFFF),
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
        core = make_path(peer, end.gateway.receiver.profile, clock.now_ns())
        path = PeerSocket(core, peer.bind, clock.now_ns)
    session = context.session if tell_backlog else None
    ports = GatewayPorts(topology, segment, end.gateway, addresses, path, session)
    loop = _GatewayLoop(context, end, ports, path)
    with ExitStack() as stack:
        if tell_backlog:
            bus = stack.enter_context(context.open_bus())
            loop.publish = _backlog_publisher(context, segment, bus)
            loop.topics = LinkTopics(bus, topology, segment, end.gateway)
            if trainer:
                loop.exercises = new_exercises(bus)
        loop.run()
        # The last figures are told when the topics are closed.
        loop.topics = None


class _GatewayLoop:
    """Sleeps, and does one step of `end` after the other.

    publish, topics, exercises: what is told to the session, and what a trainer says.
    """

    def __init__(
        self, context: Context, end: GatewayEnd, ports: GatewayPorts, path: PeerSocket | None
    ) -> None:
        self._context, self._end, self._ports, self._path = context, end, ports, path
        self._slots, self._clock_ns = end.slots, context.clock.now_ns
        self._to_haptic_end = ports.to_haptic_end.send
        self.publish: Callable[[Backlog, int], None] | None = None
        self.topics: LinkTopics | None = None
        self.exercises: Callable[[], Exercises | None] | None = None
        # Lists, because an array checks the type of each number.
        self._lateness: list[int] = []
        self._sending: list[int] = []
        context.on_flush(self._tell)

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
            slot = now_ns >= slots.wake_ns
            deadline_ns = slots.deadline_ns
            if slot:
                now_ns = self._run_slot(now_ns)
            while (frame := poll_radio(now_ns)) is not None:
                to_peer(frame)
            if slot:
                self._sending.append(clock_ns() - deadline_ns)
                self._use_rest(now_ns)
            alarm_ns = poll_timeout()

    def _fetch_frame(self, now_ns: int) -> None:
        # One frame a time: a second one is rare, and asking for it costs a system call.
        frame = self._ports.frame()
        if frame is None:
            return
        self._end.handle_frame(frame, now_ns)
        self._deliver()
        slots = self._slots
        if now_ns >= slots.figures_ns and slots.poll_figures(now_ns, heard=True):
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
        slots.handle_ready(now_ns)
        deadline_ns = slots.deadline_ns
        while now_ns < deadline_ns:
            now_ns = clock_ns()
        self._lateness.append(slots.handle_slot(ports.samples(), now_ns))
        return now_ns

    def _use_rest(self, now_ns: int) -> None:
        """Do what has most of a slot left, right after the frame was sent."""
        slots = self._slots
        if self._path is not None and self._path.work(slots.deadline_ns):
            # What else can wait finds a slot of its own.
            return
        if self.publish is not None and (backlog := slots.poll_backlog()) is not None:
            self.publish(backlog, now_ns)
        if now_ns >= slots.figures_ns and slots.poll_figures(now_ns, heard=False):
            self._context.tick(now_ns)
        # On one machine the peer's slot is at the same time, so its frame is most often here by
        # now. To read in vain costs less than to ask.
        self._fetch_frame(self._clock_ns())
        if self.topics is not None and now_ns >= self.topics.due_ns:
            self.topics.handle_time(now_ns)
            if self.exercises is not None and (found := self.exercises()) is not None:
                self._end.handle_exercises(found, now_ns)

    def _tell(self) -> None:
        probe, now_ns = self._context.probe, self._clock_ns()
        for kind, instants in ((LatenessRow, self._lateness), (SendingRow, self._sending)):
            probe.series(kind).extend_column(instants)
            instants.clear()
        ports = self._ports
        refused = ports.to_peer.failed
        probe.tell(SocketFigures(unsent=refused, strangers=ports.strangers()))
        self._end.handle_refused(refused, ports.to_peer.why, now_ns)
        figures = self._end.tell(now_ns, None if self._path is None else self._path.report())
        if self.topics is not None:
            self.topics.handle_figures(figures, now_ns)


def _backlog_publisher(
    context: Context, segment: Segment, bus: TopicBus
) -> Callable[[Backlog, int], None]:
    """Return a function that publishes a backlog with its instant."""
    topic = context.topology.link(segment.transmits).backlog_topic
    writer = bus.writer(topic, max_octets=BACKLOG_OCTETS, wake=False)

    def publish(backlog: Backlog, now_ns: int) -> None:
        writer.publish_octets(backlog.pack(), CaptureStamp(now_ns, 0, "gateway"))

    return publish
