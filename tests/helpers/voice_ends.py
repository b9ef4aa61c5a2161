"""The sender of a voice, and one of its packets."""

from kontur_av.rtp.sender import RtpIdentity
from kontur_av.streams.voice_sender import VoiceSender

#: A SILK packet of 20 ms with voice activity and without a copy of the one before.
PACKET = b"\x08\x80" + bytes(18)


def make_voice_sender(**changes) -> VoiceSender:
    settings = {"cap_bps": 8_000, "channel_bps": 64_000, "cname": "test"}
    return VoiceSender(identity=RtpIdentity(5, 65_530, 2**32 - 960), **settings | changes)
