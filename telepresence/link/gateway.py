"""The gateway of one segment: what it sends, the radio path it sends through, what it receives.

A shell that binds sockets needs six lines a wake-up:

1. Every datagram on a flow's port: `handle_datagram(flow name, data, now_ns)`.
2. Every datagram on the haptic port: `handle_haptic(data, now_ns)`.
3. Every datagram on the radio's port: `handle_radio(frame, now_ns)`.
4. Once a slot, on absolute deadlines: `handle_slot(now_ns)`.
5. Until None: `poll_transmit(now_ns)` to the radio's peer.
6. Until None: `next_event()` to the haptic endpoint or to the flow's local consumer.

Between slots, `poll_timeout()` says when the radio gives the next frame out.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from telepresence.link.flows import Flow, Level
from telepresence.link.profile import LinkProfile
from telepresence.link.queues import QueueLimits
from telepresence.link.radio import RadioPath
from telepresence.link.receiver import LinkEvent, LinkReceiver
from telepresence.link.sender import LinkSender


class Gateway:
    """Sender, radio path and receiver of one segment; see the module for the run loop.

    transmit, receive: the profiles of the way out and of the way in.
    transmit_flows, receive_flows: the flow tables; the peer has them the other way round.
    radio: the path of the frames that go out; without one they leave at once.
    limits: queue limits by level, where they differ from the defaults.
    """

    def __init__(
        self,
        *,
        transmit: LinkProfile,
        transmit_flows: Sequence[Flow],
        receive: LinkProfile,
        receive_flows: Sequence[Flow],
        radio: RadioPath | None = None,
        limits: Mapping[Level, QueueLimits] | None = None,
    ) -> None:
        self.sender = LinkSender(transmit, transmit_flows, limits=limits)
        self.receiver = LinkReceiver(receive, receive_flows)
        self.radio = RadioPath() if radio is None else radio

    def handle_datagram(self, flow: str, data: bytes, now_ns: int) -> bool:
        """A local UDP payload for the other segment; False, and counted, where it is refused."""
        return self.sender.handle_packet(flow, data, now_ns)

    def handle_haptic(self, data: bytes, now_ns: int) -> bool:
        """A local sample for the other segment; False, and counted, if its length is wrong."""
        return self.sender.handle_haptic(data, now_ns)

    def handle_radio(self, frame: bytes, now_ns: int) -> None:
        """What came from the other segment."""
        meetings = self.receiver.meetings
        self.receiver.handle_frame(frame, now_ns)
        if self.receiver.meetings != meetings:
            # Whoever begins to send has begun to listen, too, and knows no context yet.
            self.sender.forget_contexts()

    def handle_slot(self, now_ns: int) -> None:
        """A slot begins: exactly one frame goes to the antenna."""
        self.radio.handle_frame(self.sender.poll_transmit(now_ns), now_ns)

    def poll_transmit(self, now_ns: int) -> bytes | None:
        """The next frame that reaches the other segment now. Call until None."""
        return self.radio.poll_transmit(now_ns)

    def poll_timeout(self) -> int | None:
        """When `poll_transmit` has something next."""
        return self.radio.poll_timeout()

    def next_event(self) -> LinkEvent | None:
        """What the other segment sent. Call until None."""
        return self.receiver.next_event()

    def report(self, now_ns: int) -> dict[str, Any]:
        """`transmit` and `receive`, each with its profile's name, and `radio`."""
        return {
            "transmit": {"name": self.sender.profile.name, **self.sender.report(now_ns)},
            "receive": {"name": self.receiver.profile.name, **self.receiver.report()},
            "radio": self.radio.report(),
        }
