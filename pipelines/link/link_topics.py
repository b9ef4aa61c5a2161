"""What a gateway publishes for a recorder: its figures ten times a second, and all its frames.

Telemetry gets a few of its figures twice a second.

Nothing is made while nobody reads.
"""

from itertools import count
from typing import Final

import msgspec

from kontur_av.clock import NS_PER_MS
from kontur_av.media import CaptureStamp
from kontur_av.topics.bus import TopicBus, Writer
from pipelines.link.figures import LINK_STATE_OCTETS, link_values, pack_link
from pipelines.link.frame_batch import pack_frames
from pipelines.session.setup.segments import Segment
from pipelines.session.topology import Topology, gateway_topic, link_state_topic
from telepresence.link.figures import GatewayFigures
from telepresence.link.gateway import Gateway

#: Frames of this time are one sample.
_BATCH_NS: Final = 20 * NS_PER_MS
#: Figures are made, and readers looked for, once in this many batches.
_SELDOM: Final = 5
#: Room for most samples; a topic makes more for a larger one.
_FIGURES_OCTETS, _FRAMES_OCTETS = 4 << 10, 16 << 10


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
        self._figures = bus.writer(gateway_topic(segment), max_octets=_FIGURES_OCTETS, wake=False)
        self._sent = bus.writer(out.sent_frames_topic, max_octets=_FRAMES_OCTETS, wake=False)
        self._received = bus.writer(
            back.received_frames_topic, max_octets=_FRAMES_OCTETS, wake=False
        )
        self._state = bus.writer(
            link_state_topic(segment), max_octets=LINK_STATE_OCTETS, wake=False
        )
        self._numbers = {
            writer: count() for writer in (self._figures, self._sent, self._received, self._state)
        }
        # The first call looks for readers.
        self._batches = _SELDOM - 1

    def handle_time(self, now_ns: int) -> None:
        self.due_ns = now_ns + _BATCH_NS
        gateway = self._gateway
        if gateway.frames_sent:
            self._publish(self._sent, pack_frames(gateway.frames_sent), now_ns)
            gateway.frames_sent = []
        if gateway.frames_received:
            self._publish(self._received, pack_frames(gateway.frames_received), now_ns)
            gateway.frames_received = []
        self._batches += 1
        if self._batches % _SELDOM:
            return
        gateway.frames_sent = _kept(gateway.frames_sent, self._sent)
        gateway.frames_received = _kept(gateway.frames_received, self._received)
        if self._figures.has_readers():
            figures = msgspec.msgpack.encode(gateway.report(now_ns))
            self._publish(self._figures, figures, now_ns)

    def handle_figures(self, figures: GatewayFigures, now_ns: int) -> None:
        """Publish for telemetry what was counted for the report anyway, twice a second."""
        self._publish(self._state, pack_link(link_values(figures)), now_ns)

    def _publish(self, writer: Writer, octets: bytes, now_ns: int) -> None:
        stamp = CaptureStamp(now_ns, next(self._numbers[writer]), "gateway")
        writer.publish_octets(octets, stamp)


def _kept(frames: list[tuple[int, bytes]] | None, writer: Writer) -> list[tuple[int, bytes]] | None:
    if not writer.has_readers():
        return None
    return [] if frames is None else frames
