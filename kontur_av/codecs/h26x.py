"""Pictures to access units of H.264 and HEVC, by libx264 and libx265 in PyAV; and H.264 back."""

from typing import ClassVar

from kontur_av.codecs.av_encoder import EncodedPicture
from kontur_av.codecs.decoder import VideoDecoder
from kontur_av.codecs.encoder import VideoEncoder
from kontur_av.codecs.encoder_settings import EncoderSettings, H264Settings, H265Settings
from kontur_av.media import VideoCodec
from kontur_av.rtp.annex_b import join_annex_b, split_annex_b
from kontur_av.rtp.nal_formats import H264, H264_IDR, H264_SEI, H265, H265_PREFIX_SEI

_SEI_USER_DATA_UNREGISTERED = 5


class H264Encoder(VideoEncoder):
    """Encodes by libx264; see `VideoEncoder`. A refresh of 60 s and more is a key picture."""

    codec: ClassVar[VideoCodec] = "h264"
    _settings_of: ClassVar[type[EncoderSettings]] = H264Settings
    _sharpens: ClassVar[bool] = True

    def _finished(self, coded: EncodedPicture) -> tuple[bytes, bool]:
        if not coded.flagged:
            return coded.data, False
        data = without_user_data(coded.data)
        # x264 also flags the first picture of a refresh wave, at which not every decoder can start.
        return data, any(H264.nal_type(nal) == H264_IDR for nal in split_annex_b(data))


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
        if not (H264.nal_type(nal) == H264_SEI and nal[1] == _SEI_USER_DATA_UNREGISTERED)
    ]
    return join_annex_b(kept)


#: The mean squared error of the luma, per quantiser step. Measured: from half of it to twice.
_LOSS_PER_STEP = 0.4


class H265Encoder(VideoEncoder):
    """Encodes by libx265; see `VideoEncoder`. A refresh of 3 s and more is a key picture."""

    codec: ClassVar[VideoCodec] = "h265"
    _settings_of: ClassVar[type[EncoderSettings]] = H265Settings

    def _finished(self, coded: EncodedPicture) -> tuple[bytes, bool]:
        nals = split_annex_b(coded.data)
        kinds = [H265.nal_type(nal) for nal in nals]
        keyframe = not H265.keys.isdisjoint(kinds)
        if H265.sps in kinds and not keyframe:
            # x265 begins a wave with parameter sets, but does not tell its length.
            slices = next(at for at, kind in enumerate(kinds) if kind in H265.slices)
            nals.insert(slices, recovery_point(self.refresh_pictures - 1))
        return join_annex_b(nals), keyframe

    def _coding_loss(self, coded: EncodedPicture) -> float:
        # x265 does not report the error, so estimate it from the quantiser.
        return _LOSS_PER_STEP * 2 ** ((coded.quantiser - 4) / 6)


def recovery_point(pictures: int) -> bytes:
    """Return a recovery point SEI (ITU-T H.265 clause D.2.8) of at most 32767 pictures."""
    number = f"{2 * pictures:b}" if pictures else "1"
    bits = "0" * (len(number) - 1) + number + "10" + "1"
    payload = int(bits + "0" * (-len(bits) % 8), 2).to_bytes(-(-len(bits) // 8), "big")
    return bytes((H265_PREFIX_SEI << 1, 1, 6, len(payload))) + payload + b"\x80"


def encoder_of(codec: VideoCodec) -> type[VideoEncoder]:
    """Return the encoder of a codec."""
    return H265Encoder if codec == "h265" else H264Encoder


def settings_of(codec: VideoCodec) -> type[EncoderSettings]:
    """Return the settings of the encoder of a codec."""
    return H265Settings if codec == "h265" else H264Settings
