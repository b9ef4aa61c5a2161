"""RTP (RFC 3550) for H.264, HEVC and Opus: senders, receivers, the jitter buffer, and SDP.

All modules here are cores: datagrams and instants come in, datagrams and events go out.
"""

from typing import TYPE_CHECKING

from kontur_av.lazy import lazy_names

if TYPE_CHECKING:
    from kontur_av.rtp.sdp import StreamDescription, parse_sdp, write_sdp
    from kontur_av.rtp.sender import RtpIdentity

__all__ = [
    "RtpIdentity",
    "StreamDescription",
    "parse_sdp",
    "write_sdp",
]

__getattr__, __dir__ = lazy_names(__name__)
