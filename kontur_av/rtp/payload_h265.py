"""HEVC in RTP without decoding order numbers (RFC 7798): single NAL units, AP and FU."""

from collections.abc import Mapping, Sequence
from typing import ClassVar

from kontur_av.media import VideoCodec
from kontur_av.rtp.nal_payload import NalFormat

NAL_VPS, NAL_SPS, NAL_PPS, NAL_AUD, NAL_PREFIX_SEI = 32, 33, 34, 35, 39  # H.265 table 7-1
#: The types of pictures of intra slices at which a decoder can start (IRAP).
IRAP = frozenset(range(16, 24))
#: Random access skipped leading pictures.
RASL = frozenset((8, 9))
AP, FU = 48, 49  # RFC 7798 sections 4.4.2 and 4.4.3

_FORBIDDEN_BIT = 0x80


class _H265Format(NalFormat):
    codec: ClassVar[VideoCodec] = "h265"
    header_octets = 2
    largest = 47
    aggregate, fragment = AP, FU
    sps, sei = NAL_SPS, NAL_PREFIX_SEI
    set_names: ClassVar[Mapping[int, str]] = {NAL_VPS: "VPS", NAL_SPS: "SPS", NAL_PPS: "PPS"}
    slices = frozenset((*range(10), *IRAP))
    keys = IRAP
    leading = RASL
    #: ITU-T H.265 clause 7.4.2.4.4.
    beginners = frozenset((NAL_VPS, NAL_SPS, NAL_PPS, NAL_AUD, NAL_PREFIX_SEI, *range(41, 45)))

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
