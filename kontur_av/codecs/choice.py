"""The encoder of a codec, by its name."""

from kontur_av.codecs.encoder import VideoEncoder
from kontur_av.codecs.encoder_settings import EncoderSettings
from kontur_av.codecs.h264 import H264Encoder
from kontur_av.codecs.h264_settings import H264Settings
from kontur_av.codecs.h265 import H265Encoder
from kontur_av.codecs.h265_settings import H265Settings
from kontur_av.media import VideoCodec


def encoder_of(codec: VideoCodec) -> type[VideoEncoder]:
    """Return the class of the encoder."""
    return H265Encoder if codec == "h265" else H264Encoder


def settings_of(codec: VideoCodec) -> type[EncoderSettings]:
    """Return the class of the encoder's settings."""
    return H265Settings if codec == "h265" else H264Settings
