"""Busy services on the link of a session, on virtual time: not one haptic sample is lost."""

from service_pair import ServiceEnd
from virtual_link import VirtualLink

from kontur_av.clock import NS_PER_S
from telepresence.link.flows import HapticReceived, Level, PacketReceived, packet_flow
from telepresence.link.gateway import BacklogReporter

OCTETS = bytes(range(256)) * 64
FLOW = "maintenance"


def test_busy_streams_both_ways_take_no_slot_from_haptics() -> None:
    flows = [packet_flow(FLOW, Level.MAINTENANCE)]
    link = VirtualLink(uplink_flows=flows, downlink_flows=flows)
    pairs = (
        (link.ground, ServiceEnd(1), BacklogReporter(link.ground)),
        (link.space, ServiceEnd(2), BacklogReporter(link.space)),
    )
    given = {gateway: 0 for gateway, _, _ in pairs}
    came = dict(given)
    while link.now_ns < 12 * NS_PER_S:
        now_ns = link.now_ns
        for gateway, end, reporter in pairs:
            # In the last slots the samples that are on their way arrive.
            if now_ns >= NS_PER_S and now_ns < 11 * NS_PER_S:
                gateway.handle_haptic(bytes(12), now_ns)
                given[gateway] += 1
            if (told := reporter.poll_transmit(now_ns)) is not None:
                end.streams.handle_link(
                    heard=told.peer_heard, waiting_octets=told.maintenance_octets, now_ns=now_ns
                )
            if end is pairs[0][1] and len(end.programs) < 3:
                end.open(now_ns)
            for program in end.programs.values():
                if not program.pending:
                    program.write(OCTETS)
            for datagram in end.work(now_ns):
                gateway.handle_datagram(FLOW, datagram, now_ns)
        for gateway, event in link.step():
            if isinstance(event, HapticReceived):
                came[gateway] += 1
            elif isinstance(event, PacketReceived):
                end = next(end for other, end, _ in pairs if other is gateway)
                end.streams.handle_datagram(event.data, link.now_ns)
    assert list(came.values()) == list(given.values()) == [10_000, 10_000]
    for _, end, _ in pairs:
        counts = end.streams.report()
        assert counts.service_octets_received > 50_000
        assert counts.service_streams_reset == counts.service_octets_resent == 0
