"""A segment's gateway process: UDP ports on one side, one transfer frame a slot on the other."""

import select

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.media import CaptureStamp
from pipelines.names import BACKLOG, backlog_topic
from pipelines.process import PATIENCE_NS, Context, Segment
from telepresence.haptics.schedule import PeriodicSchedule
from telepresence.link.flows import Level
from telepresence.link.frame import MAX_PACKET_OCTETS
from telepresence.link.gateway import Gateway
from telepresence.link.radio import RadioPath
from telepresence.link.receiver import HapticReceived

#: A burst larger than this in one slot waits in the socket for the next one.
_MOST_DATAGRAMS = 64
#: How often, at the most, the senders are told what waits.
_TELL_NS = 4 * NS_PER_MS


def run_gateway(context: Context, *, segment: Segment) -> None:
    """Bind the flows' ports, and exchange one frame a slot with the other segment."""
    clock, probe, setup = context.clock, context.probe, context.setup
    ports = setup.ports
    ground = segment is Segment.GROUND
    flows = (setup.uplink_flows, setup.downlink_flows)
    gateway = Gateway(
        transmit=setup.uplink if ground else setup.downlink,
        transmit_flows=flows[0] if ground else flows[1],
        receive=setup.downlink if ground else setup.uplink,
        receive_flows=flows[1] if ground else flows[0],
        radio=RadioPath(delay_ns=round(setup.radio_delay_ms * NS_PER_MS)),
    )
    radio = context.listen(ports.ground_radio if ground else ports.space_radio)
    to_peer = context.sender(ports.space_radio if ground else ports.ground_radio)
    haptic = context.listen(ports.ground_haptic if ground else ports.space_haptic)
    to_haptic_end = context.sender(ports.robot if ground else ports.joystick)
    entries = {context.listen(ports.entry(flow.name)): flow.name for flow in gateway.sender.flows}
    exits = {flow.name: context.sender(ports.exit(flow.name)) for flow in gateway.receiver.flows}
    local = select.epoll()
    by_fd = {udp.fileno(): (udp, name) for udp, name in entries.items()}
    by_fd[haptic.fileno()] = (haptic, "")
    for fd in by_fd:
        local.register(fd, select.EPOLLIN)
    slot_ns = gateway.sender.profile.slot_ns
    schedule = PeriodicSchedule(start_ns=context.first_deadline_ns(slot_ns), period_ns=slot_ns)
    # Looked up once: what follows runs a thousand times a second.
    receive, clock_ns, handle_wakeup = context.receive, clock.now_ns, schedule.handle_wakeup
    handle_haptic, handle_radio = gateway.sender.handle_haptic, gateway.handle_radio
    next_event, poll_radio = gateway.receiver.next_event, gateway.radio.poll_transmit
    radio_octets = gateway.receiver.profile.frame_octets + 1
    haptic_octets = gateway.sender.profile.insert_octets + 1
    waiting_octets = gateway.sender.waiting_octets
    to_listen = [radio]
    add_lateness = probe.rows("lateness").append

    def fill() -> None:
        probe.total("slips", schedule.slips)
        probe.total("cycles", schedule.cycles)
        probe.gauge("link", gateway.report(clock_ns()))

    def fetch_local(now_ns: int) -> None:
        # There is nearly always one sample: no need to ask. For all that is seldom, one question
        # costs a third of what it costs to be told by an empty socket that it is empty.
        sample = receive(haptic, haptic_octets)
        if sample is not None:
            handle_haptic(sample, now_ns)
        for _ in range(_MOST_DATAGRAMS):
            ready = local.poll(0)
            if not ready:
                return
            for fd, _events in ready:
                udp, flow = by_fd[fd]
                datagram = receive(udp, MAX_PACKET_OCTETS + 1)
                if datagram is None:
                    continue
                if flow:
                    gateway.handle_datagram(flow, datagram, now_ns)
                else:
                    handle_haptic(datagram, now_ns)

    def fetch_radio(now_ns: int) -> None:
        # One a wake-up: there is hardly ever a second, and asking for it costs a system call.
        frame = receive(radio, radio_octets)
        if frame is not None:
            handle_radio(frame, now_ns)
        while (event := next_event()) is not None:
            if isinstance(event, HapticReceived):
                to_haptic_end(event.sample)
            else:
                exits[event.flow.name](event.data)

    context.on_flush(fill)
    with context.open_bus() as bus:
        writer = bus.writer(
            backlog_topic(gateway.sender.profile.name), max_octets=BACKLOG.size, wake=False
        )
        told = -1
        tick_ns = tell_ns = 0
        while not context.stopping:
            wait_ns = schedule.next_deadline_ns - clock_ns()
            # What comes in goes on at once; what goes out is fetched at its slot, to be newest.
            ready = select.select(to_listen, (), (), wait_ns / NS_PER_S if wait_ns > 0 else 0)[0]
            now_ns = clock_ns()
            if ready:
                fetch_radio(now_ns)
            lateness_ns = handle_wakeup(now_ns)
            if lateness_ns < 0:
                continue
            add_lateness(lateness_ns)
            fetch_local(now_ns)
            gateway.handle_slot(now_ns)
            while (frame := poll_radio(now_ns)) is not None:
                to_peer(frame)
            waiting = waiting_octets(Level.VIDEO)
            if waiting != told and now_ns >= tell_ns:
                told, tell_ns = waiting, now_ns + _TELL_NS
                writer.publish_octets(BACKLOG.pack(told), CaptureStamp(now_ns, 0, "gateway"))
            if now_ns >= tick_ns:
                tick_ns = now_ns + PATIENCE_NS
                context.tick(now_ns)
