"""The network between the two machines of a session, on virtual time, under both of its ends.

The ends are those of live machines: they handshake, protect, pack and reorder.
"""

from collections import deque
from collections.abc import Mapping

from pipelines.link.gateway_end import GatewayEnd, path_needs
from pipelines.session.setup.segments import Segment
from pipelines.session.topology.table import Topology
from telepresence.link.gateway import Gateway
from telepresence.link.link_metrics import Address
from telepresence.link.path.bundles import Bundling
from telepresence.link.peer_path import ProtectedPath
from telepresence.link.protection.identity import MachineKey
from telepresence.link.radio.network import NetworkPath

#: Of documentation (RFC 5737).
_ADDRESSES: Mapping[Segment, Address] = {
    Segment.GROUND: ("192.0.2.1", 1),
    Segment.SPACE: ("192.0.2.2", 1),
}
_KEYS = {segment: MachineKey.from_seed(bytes([n] * 32)) for n, segment in enumerate(Segment, 1)}


class NetworkWay:
    """One direction: frames go from the radio of an end through the network to the other one.

    Call `handle_slot` after each slot, and `poll_transmit` at `poll_timeout`.
    """

    def __init__(
        self,
        gateway: Gateway,
        here: ProtectedPath,
        there: ProtectedPath,
        source: Address,
        network: NetworkPath,
    ) -> None:
        self._gateway, self._here, self._there = gateway, here, there
        self._radio, self._slot_ns = gateway.radio, gateway.sender.profile.slot_ns
        self._source, self._network = source, network
        self._ready: deque[bytes] = deque()
        self._now_ns = 0

    def handle_slot(self, now_ns: int) -> None:
        """Do what the sending end does in the rest of a slot, and the receiving one in a slot."""
        here = self._here
        self._gateway.handle_path(here.allowed)
        while here.handle_rest(now_ns, now_ns + self._slot_ns):
            pass
        while (sealed := here.poll_transmit()) is not None:
            self._network.handle_datagram(sealed[0], now_ns)
        self._take(self._there.next_frame(now_ns), now_ns)

    def poll_timeout(self) -> int | None:
        """When a frame leaves the radio, a datagram arrives, or a frame is ready."""
        if self._ready:
            return self._now_ns
        dues = (self._radio.poll_timeout(), self._network.poll_timeout())
        return min((due_ns for due_ns in dues if due_ns is not None), default=None)

    def poll_transmit(self, now_ns: int) -> bytes | None:
        """The next frame for the other gateway, or None."""
        while (frame := self._radio.poll_transmit(now_ns)) is not None:
            sealed = self._here.seal(frame, now_ns)
            if sealed is not None:
                self._network.handle_datagram(sealed[0], now_ns)
        while (datagram := self._network.poll_transmit(now_ns)) is not None:
            self._take(self._there.handle_datagram(datagram, self._source, now_ns), now_ns)
        return self._ready.popleft() if self._ready else None

    def _take(self, frame: bytes | None, now_ns: int) -> None:
        self._now_ns = now_ns
        while frame is not None:
            self._ready.append(frame)
            frame = self._there.next_frame(now_ns)


class VirtualNetwork:
    """What is between both ends: their paths, and the ways out of each, by segment."""

    def __init__(
        self, topology: Topology, ends: Mapping[Segment, GatewayEnd], *, seed: int, now_ns: int
    ) -> None:
        network = topology.setup.radio_profile.network
        assert network is not None
        self.paths = {
            segment: _path(topology, segment, end.gateway, now_ns) for segment, end in ends.items()
        }
        self.ways = {
            segment: NetworkWay(
                end.gateway,
                self.paths[segment],
                self.paths[segment.peer],
                _ADDRESSES[segment],
                NetworkPath(network, f"{seed} {segment.value} network", epoch_ns=now_ns),
            )
            for segment, end in ends.items()
        }


def _path(topology: Topology, segment: Segment, gateway: Gateway, now_ns: int) -> ProtectedPath:
    setup = topology.setup
    transmit, receive = gateway.sender.profile, gateway.receiver.profile
    return ProtectedPath(
        _KEYS[segment],
        _KEYS[segment.peer].identity,
        secret=bytes(32),
        address=None if segment is Segment.GROUND else _ADDRESSES[segment.peer],
        now_ns=now_ns,
        bundling=Bundling(transmit, receive, setup.path_batch_ms, setup.path == "compact"),
        needs=path_needs(topology, segment.transmits),
    )
