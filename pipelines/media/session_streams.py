"""Makes the cores of `kontur_av.streams` for the streams of a setup."""

from kontur_av.clock import NS_PER_S
from kontur_av.media import BLOCK_NS
from kontur_av.rtp.sender import RtpIdentity
from kontur_av.streams.video_receiver import VideoReceiver
from kontur_av.streams.video_sender import VideoSender
from kontur_av.streams.voice_receiver import VoiceReceiver
from kontur_av.streams.voice_sender import VoiceSender
from pipelines.session.setup.table import VIDEO_PAYLOAD_OCTETS, Setup, VideoStream, VoiceStream
from pipelines.session.topology import Topology

#: How often a sender reports. The link has room for it: `telepresence.link.arithmetic.RESERVE_BPS`.
REPORT_INTERVAL_NS = 2 * NS_PER_S


def video_sender(
    setup: Setup, stream: VideoStream, identity: RtpIdentity, *, wall_offset_ns: int
) -> VideoSender:
    """The sender of a picture: packets leave as fast as the link carries media."""
    return VideoSender(
        cap_bps=stream.cap_bps,
        fps=stream.fps,
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
    """The sender of a voice."""
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
        largest=(stream.width, stream.height),
        report_interval_ns=None,
        reduced_size=True,
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
