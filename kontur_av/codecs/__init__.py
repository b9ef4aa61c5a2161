"""H.264, HEVC and Opus: encoders, decoders, and what is said of a coded picture."""

from typing import TYPE_CHECKING

from kontur_av.lazy import lazy_names

if TYPE_CHECKING:
    from kontur_av.codecs.coding import Coding
    from kontur_av.codecs.decoder import DecodedPicture, VideoDecoder
    from kontur_av.codecs.encoder import VideoEncoder
    from kontur_av.codecs.h26x import H264Decoder, H264Encoder, H265Encoder
    from kontur_av.codecs.opus import OpusDecoder, OpusEncoder
    from kontur_av.codecs.region import Focus, Region

__all__ = [
    "Coding",
    "DecodedPicture",
    "Focus",
    "H264Decoder",
    "H264Encoder",
    "H265Encoder",
    "OpusDecoder",
    "OpusEncoder",
    "Region",
    "VideoDecoder",
    "VideoEncoder",
]

__getattr__, __dir__ = lazy_names(__name__)
