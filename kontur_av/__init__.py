"""Real-time media for thin links: from a camera or a microphone to RTP packets, and back.

This package needs no robot and no radio.

`PictureSender`, `SoundSender` and `StreamReceiver` are whole ends of a stream, as in
samples/send_numpy.py. They drive cores (`VideoSender`, `VideoReceiver`, `VoiceSender`,
`VoiceReceiver`), which open no socket and ask no clock.
"""

from typing import TYPE_CHECKING

from kontur_av.lazy import lazy_names

if TYPE_CHECKING:
    from kontur_av.clock import ManualClock, MonotonicClock
    from kontur_av.codecs.coding import Coding
    from kontur_av.codecs.decoder import DecodedPicture, VideoDecoder
    from kontur_av.codecs.encoder import VideoEncoder
    from kontur_av.codecs.h26x import H264Decoder, H264Encoder, H265Encoder
    from kontur_av.codecs.opus import OpusDecoder, OpusEncoder
    from kontur_av.codecs.region import Region
    from kontur_av.errors import ConfigError, ProtocolError
    from kontur_av.media import (
        AccessUnit,
        AudioFrame,
        CaptureStamp,
        Quality,
        VideoFrame,
        empty_picture,
        planes,
    )
    from kontur_av.rtp.sdp import StreamDescription, parse_sdp, write_sdp
    from kontur_av.rtp.sender import RtpIdentity
    from kontur_av.sources import AudioSource, VideoSource, open_audio, open_video
    from kontur_av.streams.encoding_thread import EncodingThread
    from kontur_av.streams.ends import PictureSender, Received, SoundSender, StreamReceiver
    from kontur_av.streams.lipsync import LipSync
    from kontur_av.streams.sending import send
    from kontur_av.streams.staleness import Staleness
    from kontur_av.streams.udp import UdpReceiver, UdpSender
    from kontur_av.streams.video_receiver import VideoReceiver
    from kontur_av.streams.video_sender import VideoSender
    from kontur_av.streams.voice_receiver import VoicePlayer, VoiceReceiver
    from kontur_av.streams.voice_sender import VoiceSender
    from kontur_av.topics.bus import TopicBus

__version__ = "0.1.0"

__all__ = [
    "AccessUnit",
    "AudioFrame",
    "AudioSource",
    "CaptureStamp",
    "Coding",
    "ConfigError",
    "DecodedPicture",
    "EncodingThread",
    "H264Decoder",
    "H264Encoder",
    "H265Encoder",
    "LipSync",
    "ManualClock",
    "MonotonicClock",
    "OpusDecoder",
    "OpusEncoder",
    "PictureSender",
    "ProtocolError",
    "Quality",
    "Received",
    "Region",
    "RtpIdentity",
    "SoundSender",
    "Staleness",
    "StreamDescription",
    "StreamReceiver",
    "TopicBus",
    "UdpReceiver",
    "UdpSender",
    "VideoDecoder",
    "VideoEncoder",
    "VideoFrame",
    "VideoReceiver",
    "VideoSender",
    "VideoSource",
    "VoicePlayer",
    "VoiceReceiver",
    "VoiceSender",
    "empty_picture",
    "open_audio",
    "open_video",
    "parse_sdp",
    "planes",
    "send",
    "write_sdp",
]

__getattr__, __dir__ = lazy_names(__name__)
