"""The ends of a session's streams, and their figures as a process reports them.

Only this module knows both the events of `kontur_av.streams` and the figures of a session.
"""

from collections.abc import Callable

from kontur_av.clock import NS_PER_S
from kontur_av.media import BLOCK_NS
from kontur_av.rtp.nal_depacketizer import ReceivedUnit
from kontur_av.rtp.sender import RTP_HEADER_OCTETS, RtpIdentity
from kontur_av.streams.video_receiver import VideoReceiver
from kontur_av.streams.video_sender import PictureCoded, VideoSender
from kontur_av.streams.voice_receiver import VoiceReceiver
from kontur_av.streams.voice_sender import VoiceSender
from pipelines.media.gain import CapGain
from pipelines.media.media_metrics import GainMetrics
from pipelines.session.probe import Probe
from pipelines.session.session_metrics import CodingRow, OutRow, RxRow, TxRow
from pipelines.session.setup.table import VIDEO_PAYLOAD_OCTETS, Setup, VideoStream, VoiceStream
from pipelines.session.topology.table import Topology

#: How often a sender reports. The link has room for it: `telepresence.link.arithmetic.RESERVE_BPS`.
REPORT_INTERVAL_NS = 2 * NS_PER_S


def video_sender(
    setup: Setup, stream: VideoStream, identity: RtpIdentity, *, wall_offset_ns: int
) -> VideoSender:
    """The sender of a picture: packets leave as fast as the link carries media."""
    return VideoSender(
        cap_bps=stream.cap_bps,
        fps=stream.coded_hz,
        camera_hz=stream.fps,
        identity=identity,
        cname=setup.direction_of(stream).sender.cname,
        channel_bps=setup.profile_of(stream).media_bps,
        wall_offset_ns=wall_offset_ns,
        max_payload_octets=VIDEO_PAYLOAD_OCTETS,
        report_interval_ns=REPORT_INTERVAL_NS,
    )


def voice_sender(
    setup: Setup, stream: VoiceStream, identity: RtpIdentity, *, wall_offset_ns: int
) -> VoiceSender:
    return VoiceSender(
        cap_bps=stream.cap_bps,
        identity=identity,
        cname=setup.direction_of(stream).sender.cname,
        channel_bps=setup.profile_of(stream).media_bps,
        wall_offset_ns=wall_offset_ns,
        report_interval_ns=REPORT_INTERVAL_NS,
    )


def video_receiver(stream: VideoStream, *, ssrc: int, wall_offset_ns: int) -> VideoReceiver:
    """The receiver of a picture. The link reports the way back, so it sends no signs of life."""
    return VideoReceiver(
        ssrc=ssrc,
        name=stream.name,
        wall_offset_ns=wall_offset_ns,
        codec=stream.codec,
        largest=(stream.width, stream.height),
        report_interval_ns=None,
        reduced_size=True,
        marked=True,
    )


def voice_receiver(
    topology: Topology, stream: VoiceStream, *, wall_offset_ns: int
) -> VoiceReceiver:
    """The receiver of a voice, in lip-sync with the picture of the same place."""
    setup, shown = topology.setup, topology.shown_with(stream.name)
    return VoiceReceiver(
        name=stream.name,
        wall_offset_ns=wall_offset_ns,
        oldest_picture_ns=0 if shown is None else setup.stale_after_ns(shown.stream),
        oldest_sound_ns=setup.stale_after_ns(stream) - 2 * BLOCK_NS,
    )


class Outgoing:
    """Sends the packets that may leave, and notes them.

    to_rtp, to_rtcp: called with each datagram and the instant.
    """

    def __init__(
        self,
        sender: VideoSender | VoiceSender,
        probe: Probe,
        to_rtp: Callable[[bytes, int], object],
        to_rtcp: Callable[[bytes, int], object],
    ) -> None:
        self._sender = sender
        self._out = probe.series(OutRow)
        self._coding, self._units = probe.series(CodingRow), probe.series(TxRow)
        self._to_rtp = to_rtp
        self._to_rtcp = to_rtcp

    def handle_time(self, now_ns: int) -> None:
        """Send the packets that may leave now, and a report if one is due."""
        sender = self._sender
        while (packet := sender.poll_transmit(now_ns)) is not None:
            self._out.add(OutRow(now_ns, len(packet) - RTP_HEADER_OCTETS, sender.cap_bps))
            self._to_rtp(packet, now_ns)
        while (event := sender.next_event()) is not None:
            if isinstance(event, PictureCoded):
                timestamp, _, came_ns, begun_ns, _, octets, packets = event
                self._coding.add(CodingRow(timestamp, came_ns, begun_ns, octets, packets))
            else:
                self._units.add(TxRow(*event))
        report = sender.poll_report(now_ns)
        if report is not None:
            self._to_rtcp(report, now_ns)

    def close(self, now_ns: int) -> None:
        """Send a goodbye, after which a new sender is accepted at once."""
        goodbye = self._sender.goodbye(now_ns)
        if goodbye is not None:
            self._to_rtcp(goodbye, now_ns)


def publish_sender(
    probe: Probe, sender: VideoSender | VoiceSender, gain: CapGain | None = None
) -> None:
    """Put a sender's counts into the probe; gain: of its cap."""
    probe.publish(sender.counts)
    if isinstance(sender, VideoSender):
        probe.publish(sender.feedback)
    if gain is not None:
        probe.publish(GainMetrics(gained_bits=gain.gained_bits, gain_changes=gain.changes))


def note_unit(probe: Probe, unit: ReceivedUnit) -> None:
    """An access unit came out of a `VideoReceiver`."""
    probe.series(RxRow).add(RxRow(unit.timestamp, unit.received_ns))


def note_arrivals(probe: Probe, receiver: VoiceReceiver) -> None:
    """Packets of a voice may have come."""
    arrivals = receiver.take_arrivals()
    probe.series(RxRow).extend(RxRow(one.timestamp, one.received_ns) for one in arrivals)
