"""Real-time media for thin links: from a camera or a microphone to RTP packets, and back.

This package needs no robot and no radio. `import kontur_av as ka` has what most programs need:
whole ends of a stream (`PictureSender`, `SoundSender`, `StreamReceiver`), sources, encoders,
decoders and topics in shared memory. Their parts are in `kontur_av.codecs`, `.rtp`, `.sources`,
`.streams` and `.topics`; `kontur_av.media` and `.clock` have what these share.
"""

from typing import TYPE_CHECKING

from kontur_av.lazy import lazy_names

if TYPE_CHECKING:
    from kontur_av.clock import MonotonicClock
    from kontur_av.codecs import H264Decoder, H264Encoder, H265Encoder, OpusDecoder, OpusEncoder
    from kontur_av.errors import ConfigError, ProtocolError
    from kontur_av.media import AudioFrame, CaptureStamp, Quality, VideoFrame
    from kontur_av.sources import open_audio, open_video
    from kontur_av.streams import PictureSender, Received, SoundSender, StreamReceiver, send
    from kontur_av.topics import TopicBus

__version__ = "0.1.0"

#: Names that this package had in 0.1.0, by the module that has them now.
_MOVED = {
    "kontur_av.clock": "ManualClock",
    "kontur_av.codecs": "Coding DecodedPicture Region VideoDecoder VideoEncoder",
    "kontur_av.media": "AccessUnit empty_picture planes",
    "kontur_av.rtp": "RtpIdentity StreamDescription parse_sdp write_sdp",
    "kontur_av.sources": "AudioSource VideoSource",
    "kontur_av.streams": (
        "EncodingThread LipSync Staleness UdpReceiver UdpSender VideoReceiver VideoSender "
        "VoicePlayer VoiceReceiver VoiceSender"
    ),
}

__all__ = [
    "AudioFrame",
    "CaptureStamp",
    "ConfigError",
    "H264Decoder",
    "H264Encoder",
    "H265Encoder",
    "MonotonicClock",
    "OpusDecoder",
    "OpusEncoder",
    "PictureSender",
    "ProtocolError",
    "Quality",
    "Received",
    "SoundSender",
    "StreamReceiver",
    "TopicBus",
    "VideoFrame",
    "open_audio",
    "open_video",
    "send",
]

__getattr__, __dir__ = lazy_names(__name__, moved=_MOVED)
