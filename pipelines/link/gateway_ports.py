"""The UDP ports of one end of the link, and the datagrams that wait in them."""

import select
import socket
from collections.abc import Callable, Iterable, Iterator
from functools import partial

from pipelines.link.peer_socket import PeerSocket
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
from pipelines.session.topology import TELECOMMAND, TELEMETRY, Segment, Topology
from telepresence.link.frame import MAX_PACKET_OCTETS
from telepresence.link.gateway import Gateway


class GatewayPorts:
    """The sockets of one end, with counts of strangers' datagrams.

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
        self._radio_strangers = 0
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

        ready: from `poll_flows`. A stranger's datagram is None.
        """
        flow_by_fd, entries = self._flow_by_fd, self._entries
        while ready:
            for fd, _events in ready:
                flow = flow_by_fd.get(fd)
                if flow is not None:
                    yield flow, entries[flow].receive(MAX_PACKET_OCTETS + 1)
                elif self._not_peer is not None:
                    self._radio_strangers += receive(self._not_peer, 1) is not None
                    yield "radio", None
            ready = self.poll_flows(0)

    def samples(self) -> Iterable[bytes | None]:
        """Return the datagrams of the haptic port; a stranger's is None."""
        sample = self._fetch_haptic(self._haptic_octets)
        # Most slots have exactly one.
        if sample is None:
            return ()
        return self._all_samples(sample) if self._more_haptic(0) else (sample,)

    def _all_samples(self, first: bytes) -> Iterator[bytes | None]:
        yield first
        while self._more_haptic(0):
            yield self._fetch_haptic(self._haptic_octets)

    def strangers(self) -> dict[str, int]:
        """Return the number of strangers' datagrams by port, if there were any.

        A port is named by what it receives: "radio", "haptic", or the name of a flow.
        """
        counts = {"radio": self._radio_strangers, "haptic": self._haptic.strangers}
        counts |= {name: inlet.strangers for name, inlet in self._entries.items()}
        return {name: count for name, count in sorted(counts.items()) if count}
