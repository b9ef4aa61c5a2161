"""Pictures to H.264 access units, and back (ITU-T H.264): libx264 by PyAV, and FFmpeg's decoder."""

from struct import unpack_from
from typing import Any, ClassVar

from kontur_av.codecs.decoder import VideoDecoder
from kontur_av.codecs.encoder import VideoEncoder
from kontur_av.codecs.encoder_settings import EncoderSettings
from kontur_av.codecs.h264_settings import H264Settings
from kontur_av.media import VideoCodec
from kontur_av.rtp.annex_b import join_annex_b, split_annex_b
from kontur_av.rtp.payload_h264 import NAL_IDR, NAL_SEI, nal_type

_SEI_USER_DATA_UNREGISTERED = 5
#: FFmpeg's FF_QP2LAMBDA.
LAMBDA = 118


class H264Encoder(VideoEncoder):
    """Encodes by libx264; see `VideoEncoder`."""

    codec: ClassVar[VideoCodec] = "h264"
    _settings_of: ClassVar[type[EncoderSettings]] = H264Settings
    _sharpens: ClassVar[bool] = True

    def _finished(self, packet: Any) -> tuple[bytes, bool]:
        if not packet.is_keyframe:
            return bytes(packet), False
        data = without_user_data(bytes(packet))
        # x264 also flags the first picture of a refresh wave, at which not every decoder can start.
        return data, any(nal_type(nal) == NAL_IDR for nal in split_annex_b(data))

    def _quantiser_and_loss(self, packet: Any) -> tuple[float, float]:
        quality, squares = unpack_from("=I4xQ", packet.get_sidedata("quality_stats"))
        width, height = self.unit_size
        return quality / LAMBDA, squares / (width * height)


class H264Decoder(VideoDecoder):
    """Decodes H.264; see `VideoDecoder`."""

    def __init__(self, *, reordered: bool = False, size: tuple[int, int] | None = None) -> None:
        super().__init__("h264", reordered=reordered, size=size)


def without_user_data(access_unit: bytes) -> bytes:
    """Return the access unit without its user data SEI (ITU-T H.264 clause D.2.7).

    x264 begins a stream with 650 octets of text about itself: 60 ms of an 85 kbit/s channel.
    """
    kept = [
        nal
        for nal in split_annex_b(access_unit)
        if not (nal_type(nal) == NAL_SEI and nal[1] == _SEI_USER_DATA_UNREGISTERED)
    ]
    return join_annex_b(kept)
