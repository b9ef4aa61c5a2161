"""Both segments and the radio between them on virtual time: an hour of link in minutes.

The gateways are the ones of a live session, not models of them.
"""

from collections.abc import Iterator, Mapping, Sequence

from telepresence.link.flows import Flow, Level, LinkEvent
from telepresence.link.gateway import Gateway
from telepresence.link.profile import DOWNLINK, UPLINK, LinkProfile
from telepresence.link.queues import QueueLimits
from telepresence.link.radio import RadioPath


class VirtualLink:
    """A ground and a space gateway, one slot at a time.

    uplink_flows, downlink_flows: what each segment may send to the other.
    up, down: the radio paths; without one a frame arrives at the instant of its sending.
    limits: queue limits by level, where they differ from the defaults.
    seed: determines the life numbers and the secrets of the two gateways.

    Pass packets and samples to `ground` and `space` at `now_ns`, or at any instant before the next
    slot, then call `step`. The slots of both segments begin at the same instants.
    """

    def __init__(
        self,
        *,
        uplink_flows: Sequence[Flow],
        downlink_flows: Sequence[Flow],
        uplink: LinkProfile = UPLINK,
        downlink: LinkProfile = DOWNLINK,
        up: RadioPath | None = None,
        down: RadioPath | None = None,
        limits: Mapping[Level, QueueLimits] | None = None,
        seed: int = 0,
        start_ns: int = 0,
    ) -> None:
        if uplink.slot_ns != downlink.slot_ns:
            raise ValueError("both directions need the same slot_ns")
        self.slot_ns = uplink.slot_ns
        self.now_ns = start_ns
        self.ground = Gateway(
            transmit=uplink,
            transmit_flows=uplink_flows,
            receive=downlink,
            receive_flows=downlink_flows,
            radio=up,
            limits=limits,
            master=True,
            boot_id=1 + seed % 0xFFFF,
            secret=2 * seed,
            now_ns=start_ns,
        )
        self.space = Gateway(
            transmit=downlink,
            transmit_flows=downlink_flows,
            receive=uplink,
            receive_flows=uplink_flows,
            radio=down,
            limits=limits,
            master=False,
            boot_id=1 + (seed + 1) % 0xFFFF,
            secret=2 * seed + 1,
            now_ns=start_ns,
        )

    def step(self) -> Iterator[tuple[Gateway, LinkEvent]]:
        """Run one slot: send a frame from each segment, then yield what arrives before the next.

        Yields the receiving gateway and the event, in the order of time. Exhaust the iterator: time
        advances only at its end.
        """
        ground, space = self.ground, self.space
        now_ns = self.now_ns
        end_ns = now_ns + self.slot_ns
        ground.handle_slot(now_ns)
        space.handle_slot(now_ns)
        while True:
            for near, far in ((ground, space), (space, ground)):
                while (frame := near.poll_transmit(now_ns)) is not None:
                    far.handle_radio(frame, now_ns)
                    while (event := far.next_event()) is not None:
                        yield far, event
            due = [t for t in (ground.poll_timeout(), space.poll_timeout()) if t is not None]
            now_ns = min(due, default=end_ns)
            if now_ns >= end_ns:
                break
        self.now_ns = end_ns

    def run(self, duration_ns: int) -> Iterator[tuple[Gateway, LinkEvent]]:
        """Run all slots that begin within `duration_ns` from now."""
        end_ns = self.now_ns + duration_ns
        while self.now_ns < end_ns:
            yield from self.step()
