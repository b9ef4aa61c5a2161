"""A video stream's sending process: topic -> encoder -> pacer -> RTP to the gateway."""

from collections import deque

from kontur_av.budget import Pacer
from kontur_av.clock import NS_PER_S
from kontur_av.h264 import H264Encoder
from kontur_av.media import VIDEO_CLOCK_HZ
from kontur_av.rtp.sender import RTP_HEADER_OCTETS
from pipelines.names import BACKLOG, VIDEO_PAYLOAD_TYPE, backlog_topic
from pipelines.parts.sending import Outgoing
from pipelines.process import PATIENCE_NS, Context
from pipelines.setup import VideoStream

#: Small enough that no part of a coded picture takes more than a picture's share of the link.
_MAX_PAYLOAD_OCTETS = 1000


class _UnderWay:
    """A coded picture of which packets still wait in the pacer."""

    __slots__ = ("capture_ns", "encoded_ns", "packets", "timestamp")

    def __init__(self, packets: int, timestamp: int, capture_ns: int, encoded_ns: int) -> None:
        self.packets = packets
        self.timestamp = timestamp
        self.capture_ns = capture_ns
        self.encoded_ns = encoded_ns


def run_video_send(context: Context, *, stream: VideoStream, topic: str) -> None:
    """Send the newest picture of `topic` whenever the stream's budget has room for one."""
    clock, probe = context.clock, context.probe
    encoder = H264Encoder(
        width=stream.width, height=stream.height, fps=stream.fps, cap_bps=stream.cap_bps
    )
    profile = context.setup.profile_of(stream)
    pacer = Pacer(
        cap_bps=stream.cap_bps, channel_bps=profile.media_bps, slack_ns=NS_PER_S // stream.fps
    )
    outgoing = Outgoing(
        context,
        stream,
        payload_type=VIDEO_PAYLOAD_TYPE,
        clock_rate_hz=VIDEO_CLOCK_HZ,
        max_payload_octets=min(_MAX_PAYLOAD_OCTETS, pacer.max_payload_octets),
    )
    rtp = outgoing.rtp
    under_way: deque[_UnderWay] = deque()
    captured = sent = refused_by_link = 0
    picture_octets = stream.cap_bps // (8 * stream.fps)

    def fill() -> None:
        probe.total("frames_captured", captured)
        probe.total("frames_encoded", encoder.encoded)
        probe.total("frames_sent", sent)
        probe.total("frames_refused", pacer.pictures_refused + refused_by_link)
        probe.total("rtp_packets_sent", rtp.packets_sent)
        probe.gauge("backlog_octets", pacer.backlog_octets)

    context.on_flush(fill)
    with context.open_bus() as bus:
        reader = bus.reader(topic)
        backlog_reader = bus.reader(backlog_topic(profile.name))
        waiting_octets = 0

        def link_is_behind() -> bool:
            """Whether more than a picture waits in the gateway: one more would be shown late.

            The pacer keeps the cap; a link that leaves out slots carries less than that.
            """
            nonlocal waiting_octets
            newest = backlog_reader.latest()
            if newest is not None:
                with newest:
                    (waiting_octets,) = BACKLOG.unpack(newest.octets())
            return waiting_octets > picture_octets

        while not context.stopping:
            now_ns = clock.now_ns()
            context.tick(now_ns)
            due_ns = pacer.poll_timeout()
            reader.wait(PATIENCE_NS if due_ns is None else min(PATIENCE_NS, due_ns - now_ns))
            skipped = reader.skipped
            lease = reader.latest()
            if lease is not None:
                captured += 1 + reader.skipped - skipped
                with lease:
                    if link_is_behind():
                        refused_by_link += 1
                    elif pacer.ready_for_picture(clock.now_ns()):
                        unit = encoder.encode(lease.video(), clock.now_ns)
                        packets = rtp.video_packets(unit)
                        under_way.append(
                            _UnderWay(
                                len(packets),
                                rtp.timestamp(unit.stamp.capture_ns),
                                unit.stamp.capture_ns,
                                unit.encoded_ns,
                            )
                        )
                        octets = [len(packet) - RTP_HEADER_OCTETS for packet in packets]
                        pacer.handle_access_unit(packets, octets, unit.encoded_ns)
            now_ns = clock.now_ns()
            while (packet := pacer.poll_transmit(now_ns)) is not None:
                outgoing.send(packet, now_ns)
                unit_under_way = under_way[0]
                unit_under_way.packets -= 1
                if unit_under_way.packets == 0:
                    under_way.popleft()
                    sent += 1
                    probe.row(
                        "tx",
                        unit_under_way.timestamp,
                        unit_under_way.capture_ns,
                        unit_under_way.encoded_ns,
                        now_ns,
                    )
            outgoing.send_report(now_ns)
        outgoing.close()
