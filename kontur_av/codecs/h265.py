"""Pictures to HEVC access units (ITU-T H.265), by libx265 in PyAV."""

from struct import unpack_from
from typing import Any, ClassVar

from kontur_av.codecs.encoder import VideoEncoder
from kontur_av.codecs.encoder_settings import EncoderSettings
from kontur_av.codecs.h264 import LAMBDA
from kontur_av.codecs.h265_settings import H265Settings
from kontur_av.media import VideoCodec
from kontur_av.rtp.annex_b import join_annex_b, split_annex_b
from kontur_av.rtp.payload_h265 import H265, NAL_PREFIX_SEI

#: The mean squared error of the luma, per quantiser step. Measured: from half of it to twice.
_LOSS_PER_STEP = 0.4


class H265Encoder(VideoEncoder):
    """Encodes by libx265; see `VideoEncoder`. A refresh of 3 s and more is a key picture."""

    codec: ClassVar[VideoCodec] = "h265"
    _settings_of: ClassVar[type[EncoderSettings]] = H265Settings

    def _finished(self, packet: Any) -> tuple[bytes, bool]:
        data = bytes(packet)
        nals = split_annex_b(data)
        kinds = [H265.nal_type(nal) for nal in nals]
        keyframe = not H265.keys.isdisjoint(kinds)
        if H265.sps in kinds and not keyframe:
            # x265 begins a wave with parameter sets, but does not tell its length.
            slices = next(at for at, kind in enumerate(kinds) if kind in H265.slices)
            nals.insert(slices, recovery_point(self.refresh_pictures - 1))
        return join_annex_b(nals), keyframe

    def _quantiser_and_loss(self, packet: Any) -> tuple[float, float]:
        (quality,) = unpack_from("=I", packet.get_sidedata("quality_stats"))
        quantiser = quality / LAMBDA
        # x265 does not report the error, so estimate it from the quantiser.
        return quantiser, _LOSS_PER_STEP * 2 ** ((quantiser - 4) / 6)


def recovery_point(pictures: int) -> bytes:
    """Return a recovery point SEI (ITU-T H.265 clause D.2.8) of at most 32767 pictures."""
    number = f"{2 * pictures:b}" if pictures else "1"
    bits = "0" * (len(number) - 1) + number + "10" + "1"
    payload = int(bits + "0" * (-len(bits) % 8), 2).to_bytes(-(-len(bits) // 8), "big")
    return bytes((NAL_PREFIX_SEI << 1, 1, 6, len(payload))) + payload + b"\x80"
