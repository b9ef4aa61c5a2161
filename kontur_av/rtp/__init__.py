"""RTP (RFC 3550) for H.264 and Opus: senders, receivers, the jitter buffer, and SDP.

Nothing here reads a socket or a clock: datagrams and instants come in, datagrams and events go out.
"""

from kontur_av.rtp.payload_h264 import H264Depacketizer, ReceivedUnit
from kontur_av.rtp.playout import PlayoutBlock, PlayoutBuffer
from kontur_av.rtp.receiver import RtpReceived, RtpReceiver
from kontur_av.rtp.sdp import (
    AUDIO_PAYLOAD_TYPE,
    VIDEO_PAYLOAD_TYPE,
    StreamDescription,
    parse_sdp,
    write_sdp,
)
from kontur_av.rtp.sender import RTP_HEADER_OCTETS, RtpSender

__all__ = [
    "AUDIO_PAYLOAD_TYPE",
    "RTP_HEADER_OCTETS",
    "VIDEO_PAYLOAD_TYPE",
    "H264Depacketizer",
    "PlayoutBlock",
    "PlayoutBuffer",
    "ReceivedUnit",
    "RtpReceived",
    "RtpReceiver",
    "RtpSender",
    "StreamDescription",
    "parse_sdp",
    "write_sdp",
]
