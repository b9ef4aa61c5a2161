"""The common part of sending processes: RTP and reports to the gateway."""

from kontur_av.streams.video_sender import VideoSender
from kontur_av.streams.voice_sender import VoiceSender
from pipelines.media.stream_figures import Outgoing
from pipelines.session.process import Context
from pipelines.session.setup.table import VideoStream, VoiceStream


def to_gateway(
    context: Context, stream: VideoStream | VoiceStream, sender: VideoSender | VoiceSender
) -> Outgoing:
    """Return a stream's output, which sends to the gateway."""
    topology = context.topology
    send_rtp = context.sender(topology.entry_port(stream.name))
    send_rtcp = context.sender(topology.entry_port(topology.media(stream.name).rtcp))
    return Outgoing(
        sender,
        context.probe,
        lambda datagram, _: send_rtp(datagram),
        lambda datagram, _: send_rtcp(datagram),
    )
