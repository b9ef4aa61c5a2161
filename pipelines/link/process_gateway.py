"""A segment's gateway process: UDP ports on one side, one transfer frame a slot on the other.

`GatewaySlots` decides what happens when. This module has the sockets, the clock and the sleep.
"""

import secrets
import select
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial

from kontur_av.clock import NS_PER_S
from kontur_av.media import CaptureStamp
from kontur_av.topics.bus import TopicBus
from pipelines.link.clock_rows import note_clock
from pipelines.link.ends import make_gateway
from pipelines.link.figures import SocketFigures, WayInFigures
from pipelines.link.gateway_ports import GatewayPorts
from pipelines.link.link_topics import LinkTopics
from pipelines.link.peer_socket import PeerPlan, PeerSocket, make_path
from pipelines.session.datagrams import EndAddresses
from pipelines.session.exercises import new_exercises
from pipelines.session.figures import LoopFigures
from pipelines.session.process import Context
from pipelines.session.rows import LatenessRow, SendingRow
from pipelines.session.topology import Segment
from pipelines.session.training import Exercises
from telepresence.link.backlog import BACKLOG_OCTETS, Backlog
from telepresence.link.radio import RadioPath
from telepresence.link.received import HapticReceived, PacketReceived
from telepresence.link.slots import GatewaySlots

_ON_THIS_MACHINE = EndAddresses()


def run_gateway(
    context: Context,
    *,
    segment: Segment,
    addresses: EndAddresses = _ON_THIS_MACHINE,
    peer: PeerPlan | None = None,
    tell_backlog: bool = True,
    radio_after_ns: int = 0,
    trainer: bool = False,
) -> None:
    """Bind the flows' ports, and exchange one frame a slot with the other segment.

    peer: how to reach the other segment on another machine; None: it is on this one.
    tell_backlog: tell the session through shared memory how much video waits, and what a recorder
        wants to know.
    radio_after_ns: the radio's time 0, after the start of the session.
    trainer: lose the signal when a trainer says so. With `peer`, the radio of both directions is
        here, because it has one time only.
    """
    clock, probe = context.clock, context.probe
    gateway = make_gateway(
        context.topology,
        segment,
        life=1 + secrets.randbelow(0xFFFF),
        secret=secrets.randbits(128),
        seed=context.seed,
        epoch_ns=context.started_ns + radio_after_ns,
        now_ns=clock.now_ns(),
        told_offset_ns=None if peer is None else clock.wall_offset_ns,
    )
    path = back = None
    if peer is not None:
        core = make_path(peer, gateway.receiver.profile, clock.now_ns())
        path = PeerSocket(core, peer.bind, clock.now_ns)
        if trainer:
            epoch_ns = context.started_ns + radio_after_ns
            way_in = gateway.receiver.profile
            back = context.setup.radio_path(way_in, seed=context.seed, epoch_ns=epoch_ns)
            gateway.radio_in = back
    ports = GatewayPorts(context.topology, segment, gateway, addresses, path)
    slots = GatewaySlots(
        gateway, first_ns=context.first_deadline_ns(gateway.sender.profile.slot_ns)
    )
    # Looked up once: what follows runs a thousand times a second.
    clock_ns, sleep, frame_of_peer = clock.now_ns, select.select, ports.frame
    handle_radio, poll_radio, next_event = (
        gateway.handle_radio,
        gateway.radio.poll_transmit,
        gateway.next_event,
    )
    handle_slot, poll_timeout, poll_backlog = (
        slots.handle_slot,
        slots.poll_timeout if back is None else partial(_first, slots, back),
        slots.poll_backlog,
    )
    to_listen, poll_flows, samples = [ports.radio], ports.poll_flows, ports.samples
    to_peer, to_haptic_end, exits = ports.to_peer.send, ports.to_haptic_end.send, ports.exits
    work = None if path is None else path.work
    # Lists, because an array checks the type of each number.
    lateness: list[int] = []
    sending: list[int] = []
    add_lateness, add_sending = lateness.append, sending.append
    lateness_rows, sending_rows = probe.series(LatenessRow), probe.series(SendingRow)

    def fill() -> None:
        lateness_rows.extend_column(lateness)
        sending_rows.extend_column(sending)
        lateness.clear()
        sending.clear()
        schedule = slots.schedule
        probe.tell(LoopFigures(slips=schedule.slips, cycles=schedule.cycles))
        probe.tell(SocketFigures(unsent=ports.to_peer.failed, strangers=ports.strangers()))
        link = gateway.report(clock_ns())
        probe.tell(link)
        note_clock(probe, link)
        if path is not None:
            probe.tell(path.report())
        if back is not None:
            probe.tell(WayInFigures(radio_back=back.report()))
        if topics is not None:
            topics.handle_figures(link, clock_ns())

    def fetch_radio(now_ns: int) -> None:
        # One frame a time: a second one is rare, and asking for it costs a system call.
        frame = frame_of_peer()
        if frame is None:
            return
        if back is not None:
            back.handle_frame(frame, now_ns)
        else:
            take(frame, now_ns)
        if now_ns >= slots.figures_ns and slots.poll_figures(now_ns, heard=True):
            context.tick(now_ns)

    def take(frame: bytes, now_ns: int) -> None:
        handle_radio(frame, now_ns)
        while (event := next_event()) is not None:
            if isinstance(event, HapticReceived):
                to_haptic_end(event.sample)
            elif isinstance(event, PacketReceived):
                exits[event.flow.name].send(event.data)

    def follow(exercises: Exercises, now_ns: int) -> None:
        for radio in (gateway.radio, back):
            if radio is not None:
                radio.handle_outage(exercises.los_ns, now_ns)

    topics: LinkTopics | None = None
    context.on_flush(fill)
    with ExitStack() as stack:
        publish = exercises = None
        if tell_backlog:
            bus = stack.enter_context(context.open_bus())
            publish = _backlog_publisher(context, segment, bus)
            topics = LinkTopics(bus, context.topology, segment, gateway)
            if trainer:
                exercises = new_exercises(bus)
        alarm_ns = poll_timeout()
        while not context.stopping:
            wait_ns = alarm_ns - clock_ns()
            # Not epoll, whose timeouts have whole milliseconds; a timerfd costs more than it gains.
            heard = sleep(to_listen, (), (), wait_ns / NS_PER_S if wait_ns > 0 else 0)[0]
            now_ns = clock_ns()
            if heard:
                fetch_radio(now_ns)
            if back is not None:
                while (frame := back.poll_transmit(now_ns)) is not None:
                    take(frame, now_ns)
                if heard:
                    alarm_ns = poll_timeout()
            if now_ns < alarm_ns:
                continue
            slot = now_ns >= slots.wake_ns
            if slot:
                if ready := poll_flows(0):
                    slots.handle_datagrams(ports.datagrams(ready), now_ns)
                now_ns = clock_ns()
                slots.handle_ready(now_ns)
                deadline_ns = slots.deadline_ns
                while now_ns < deadline_ns:
                    now_ns = clock_ns()
                add_lateness(handle_slot(samples(), now_ns))
            while (frame := poll_radio(now_ns)) is not None:
                to_peer(frame)
            if slot:
                add_sending(clock_ns() - deadline_ns)
                if work is not None and work(slots.deadline_ns):
                    # What else can wait finds a slot of its own.
                    alarm_ns = poll_timeout()
                    continue
                if publish is not None and (backlog := poll_backlog()) is not None:
                    publish(backlog, now_ns)
                if now_ns >= slots.figures_ns and slots.poll_figures(now_ns, heard=False):
                    context.tick(now_ns)
                # On one machine the peer's slot is at the same time, so its frame is most often
                # here by now. To read in vain costs less than to ask.
                fetch_radio(clock_ns())
                if topics is not None and now_ns >= topics.due_ns:
                    topics.handle_time(now_ns)
                    if exercises is not None and (found := exercises()) is not None:
                        follow(found, now_ns)
            alarm_ns = poll_timeout()
        # The last figures are told when the topics are closed.
        topics = None


def _first(slots: GatewaySlots, back: RadioPath) -> int:
    """When to wake up, with a radio on the way in."""
    due_ns, alarm_ns = back.poll_timeout(), slots.poll_timeout()
    return alarm_ns if due_ns is None else min(due_ns, alarm_ns)


def _backlog_publisher(
    context: Context, segment: Segment, bus: TopicBus
) -> Callable[[Backlog, int], None]:
    """Return a function that publishes a backlog with its instant."""
    topic = context.topology.link(segment.transmits).backlog_topic
    writer = bus.writer(topic, max_octets=BACKLOG_OCTETS, wake=False)

    def publish(backlog: Backlog, now_ns: int) -> None:
        writer.publish_octets(backlog.pack(), CaptureStamp(now_ns, 0, "gateway"))

    return publish
