"""A segment's gateway process: UDP ports on one side, one transfer frame a slot on the other."""

import select

from kontur_av.clock import NS_PER_MS, NS_PER_S
from pipelines.process import LOOPBACK, Context, Segment
from telepresence.haptics.schedule import PeriodicSchedule
from telepresence.link.gateway import Gateway
from telepresence.link.radio import RadioPath
from telepresence.link.receiver import HapticReceived

#: A burst larger than this in one slot waits in the socket for the next one.
_MOST_DATAGRAMS = 64
_REPORT_NS = NS_PER_S // 2


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
    radio_peer = (LOOPBACK, ports.space_radio if ground else ports.ground_radio)
    haptic = context.listen(ports.ground_haptic if ground else ports.space_haptic)
    haptic_end = (LOOPBACK, ports.robot if ground else ports.joystick)
    entries = {context.listen(ports.entry(flow.name)): flow.name for flow in gateway.sender.flows}
    exits = {flow.name: (LOOPBACK, ports.exit(flow.name)) for flow in gateway.receiver.flows}
    local = select.epoll()
    by_fd = {udp.fileno(): (udp, name) for udp, name in entries.items()}
    by_fd[haptic.fileno()] = (haptic, "")
    for fd in by_fd:
        local.register(fd, select.EPOLLIN)
    slot_ns = gateway.sender.profile.slot_ns
    schedule = PeriodicSchedule(start_ns=context.first_deadline_ns(slot_ns), period_ns=slot_ns)
    report_ns = 0

    def fill() -> None:
        probe.total("slips", schedule.slips)
        probe.total("cycles", schedule.cycles)

    def fetch_local(now_ns: int) -> None:
        for fd, _ in local.poll(0):
            udp, flow = by_fd[fd]
            for _ in range(_MOST_DATAGRAMS):
                datagram = context.receive(udp)
                if datagram is None:
                    break
                if flow:
                    gateway.handle_datagram(flow, datagram, now_ns)
                else:
                    gateway.handle_haptic(datagram, now_ns)

    def fetch_radio(now_ns: int) -> None:
        # One a wake-up: there is hardly ever a second, and asking for it costs a system call.
        frame = context.receive(radio)
        if frame is not None:
            gateway.handle_radio(frame, now_ns)
        while (event := gateway.next_event()) is not None:
            if isinstance(event, HapticReceived):
                haptic.sendto(event.sample, haptic_end)
            else:
                radio.sendto(event.data, exits[event.flow.name])

    context.on_flush(fill)
    while not context.stopping:
        wait_ns = schedule.next_deadline_ns - clock.now_ns()
        # What comes in goes on at once; what goes out is fetched at its slot, so as to be newest.
        ready = select.select([radio], [], [], max(0, wait_ns) / NS_PER_S)[0]
        now_ns = clock.now_ns()
        if ready:
            fetch_radio(now_ns)
        lateness_ns = schedule.handle_wakeup(now_ns)
        if lateness_ns < 0:
            continue
        probe.row("lateness", lateness_ns)
        fetch_local(now_ns)
        gateway.handle_slot(now_ns)
        while (frame := gateway.poll_transmit(now_ns)) is not None:
            radio.sendto(frame, radio_peer)
        if now_ns >= report_ns:
            report_ns = now_ns + _REPORT_NS
            probe.gauge("link", gateway.report(now_ns))
        context.tick(now_ns)
    probe.gauge("link", gateway.report(clock.now_ns()))
