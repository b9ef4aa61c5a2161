"""One coded stream, from end to end: schedule, budget, RTP, reception and display.

`VideoSender`, `VideoReceiver`, `VoiceSender` and `VoiceReceiver` are cores, which open no socket
and ask no clock. `PictureSender`, `SoundSender` and `StreamReceiver` drive them.
"""

from typing import TYPE_CHECKING

from kontur_av.lazy import lazy_names

if TYPE_CHECKING:
    from kontur_av.streams.encoding_thread import EncodingThread
    from kontur_av.streams.lipsync import LipSync
    from kontur_av.streams.paced_sender import UnitSent
    from kontur_av.streams.senders import PictureSender, SoundSender
    from kontur_av.streams.sending import send
    from kontur_av.streams.staleness import Staleness
    from kontur_av.streams.stream_receiver import Received, StreamReceiver
    from kontur_av.streams.udp import UdpReceiver, UdpSender
    from kontur_av.streams.video_receiver import VideoReceiver
    from kontur_av.streams.video_sender import VideoSender
    from kontur_av.streams.voice_receiver import VoicePlayer, VoiceReceiver
    from kontur_av.streams.voice_sender import VoiceSender

__all__ = [
    "EncodingThread",
    "LipSync",
    "PictureSender",
    "Received",
    "SoundSender",
    "Staleness",
    "StreamReceiver",
    "UdpReceiver",
    "UdpSender",
    "UnitSent",
    "VideoReceiver",
    "VideoSender",
    "VoicePlayer",
    "VoiceReceiver",
    "VoiceSender",
    "send",
]

__getattr__, __dir__ = lazy_names(__name__)
