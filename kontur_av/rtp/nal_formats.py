"""The NAL units of H.264 and HEVC, and their payloads in RTP: single units, aggregates, fragments.

H.264 in packetization-mode 1 (RFC 6184 section 6.3): STAP-A and FU-A. HEVC without decoding order
numbers (RFC 7798): AP and FU.
"""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import ClassVar

from kontur_av.media import VideoCodec
from kontur_av.rtp.nal_payload import NalFormat

H264_SLICE, H264_IDR, H264_SEI, H264_SPS, H264_PPS, H264_AUD = 1, 5, 6, 7, 8, 9  # H.264 table 7-1
STAP_A, FU_A = 24, 28  # RFC 6184 table 3

#: In the first octet of a NAL unit; both codecs have the last.
_TYPE_BITS, _NRI_BITS, _FORBIDDEN_BIT = 0x1F, 0x60, 0x80


class _H264Format(NalFormat):
    codec: ClassVar[VideoCodec] = "h264"
    header_octets = 1
    largest = 23
    aggregate, fragment = STAP_A, FU_A
    sps, sei = H264_SPS, H264_SEI
    set_names: ClassVar[Mapping[int, str]] = {H264_SPS: "SPS", H264_PPS: "PPS"}
    #: 2 is the first partition of one.
    slices = frozenset((H264_SLICE, 2, H264_IDR))
    keys = frozenset((H264_IDR,))
    #: ITU-T H.264 clause 7.4.1.2.3.
    beginners = frozenset((H264_SEI, H264_SPS, H264_PPS, H264_AUD))

    def nal_type(self, nal_unit: bytes) -> int:
        return nal_unit[0] & _TYPE_BITS

    def is_nal(self, nal_unit: bytes) -> bool:
        return bool(nal_unit[0] & _TYPE_BITS)

    def aggregate_header(self, units: Sequence[bytes]) -> bytes:
        # RFC 6184 section 5.7.1: F is the OR of all, NRI the largest of all.
        forbidden = max(unit[0] & _FORBIDDEN_BIT for unit in units)
        nri = max(unit[0] & _NRI_BITS for unit in units)
        return bytes((forbidden | nri | STAP_A,))

    def fragment_header(self, unit: bytes) -> bytes:
        return bytes(((unit[0] & (_FORBIDDEN_BIT | _NRI_BITS)) | FU_A,))

    def nal_header(self, payload_header: bytes, kind: int) -> bytes:
        return bytes(((payload_header[0] & (_FORBIDDEN_BIT | _NRI_BITS)) | kind,))


H264 = _H264Format()

H265_VPS, H265_SPS, H265_PPS, H265_AUD, H265_PREFIX_SEI = 32, 33, 34, 35, 39  # H.265 table 7-1
#: The types of pictures of intra slices at which a decoder can start (IRAP).
IRAP = frozenset(range(16, 24))
#: Random access skipped leading pictures.
RASL = frozenset((8, 9))
AP, FU = 48, 49  # RFC 7798 sections 4.4.2 and 4.4.3


class _H265Format(NalFormat):
    codec: ClassVar[VideoCodec] = "h265"
    header_octets = 2
    largest = 47
    aggregate, fragment = AP, FU
    sps, sei = H265_SPS, H265_PREFIX_SEI
    set_names: ClassVar[Mapping[int, str]] = {H265_VPS: "VPS", H265_SPS: "SPS", H265_PPS: "PPS"}
    slices = frozenset((*range(10), *IRAP))
    keys = IRAP
    leading = RASL
    #: ITU-T H.265 clause 7.4.2.4.4.
    beginners = frozenset((H265_VPS, H265_SPS, H265_PPS, H265_AUD, H265_PREFIX_SEI, *range(41, 45)))

    def nal_type(self, nal_unit: bytes) -> int:
        return nal_unit[0] >> 1 & 0x3F

    def is_nal(self, nal_unit: bytes) -> bool:
        # nuh_temporal_id_plus1 is never 0.
        return len(nal_unit) > 1 and bool(nal_unit[1] & 7)

    def aggregate_header(self, units: Sequence[bytes]) -> bytes:
        # Section 4.4.2: F is the OR of all, the layer and the temporal layer are the lowest.
        forbidden = max(unit[0] & _FORBIDDEN_BIT for unit in units)
        layer = min((unit[0] & 1) << 5 | unit[1] >> 3 for unit in units)
        temporal = min(unit[1] & 7 for unit in units)
        return bytes((forbidden | AP << 1 | layer >> 5, (layer & 31) << 3 | temporal))

    def fragment_header(self, unit: bytes) -> bytes:
        return self.nal_header(unit, FU)

    def nal_header(self, payload_header: bytes, kind: int) -> bytes:
        kept = payload_header[0] & (_FORBIDDEN_BIT | 1)
        return bytes((kept | kind << 1, payload_header[1]))


H265 = _H265Format()

NAL_FORMATS: Mapping[VideoCodec, NalFormat] = MappingProxyType({"h264": H264, "h265": H265})


def parameter_sets_of(access_unit: bytes, codec: VideoCodec) -> bytes:
    """Return the parameter sets of an access unit, as Annex B; b"" if it has no SPS."""
    return NAL_FORMATS[codec].parameter_sets(access_unit)
