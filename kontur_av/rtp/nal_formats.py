"""The format of NAL units by its codec."""

from collections.abc import Mapping
from types import MappingProxyType

from kontur_av.media import VideoCodec
from kontur_av.rtp.nal_payload import NalFormat
from kontur_av.rtp.payload_h264 import H264
from kontur_av.rtp.payload_h265 import H265

NAL_FORMATS: Mapping[VideoCodec, NalFormat] = MappingProxyType({"h264": H264, "h265": H265})


def parameter_sets_of(access_unit: bytes, codec: VideoCodec) -> bytes:
    """Return the parameter sets of an access unit, as Annex B; b"" if it has no SPS."""
    return NAL_FORMATS[codec].parameter_sets(access_unit)
