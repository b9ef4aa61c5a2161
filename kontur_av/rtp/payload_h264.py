"""H.264 in RTP, packetization-mode 1 (RFC 6184 section 6.3): single NAL units, STAP-A and FU-A."""

from collections.abc import Mapping, Sequence
from typing import ClassVar

from kontur_av.media import VideoCodec
from kontur_av.rtp.nal_payload import NalFormat

NAL_SLICE, NAL_IDR, NAL_SEI, NAL_SPS, NAL_PPS, NAL_AUD = 1, 5, 6, 7, 8, 9  # H.264 table 7-1
STAP_A, FU_A = 24, 28  # RFC 6184 table 3

_TYPE_BITS, _NRI_BITS, _FORBIDDEN_BIT = 0x1F, 0x60, 0x80


class _H264Format(NalFormat):
    codec: ClassVar[VideoCodec] = "h264"
    header_octets = 1
    largest = 23
    aggregate, fragment = STAP_A, FU_A
    sps, sei = NAL_SPS, NAL_SEI
    set_names: ClassVar[Mapping[int, str]] = {NAL_SPS: "SPS", NAL_PPS: "PPS"}
    #: 2 is the first partition of one.
    slices = frozenset((NAL_SLICE, 2, NAL_IDR))
    keys = frozenset((NAL_IDR,))
    #: ITU-T H.264 clause 7.4.1.2.3.
    beginners = frozenset((NAL_SEI, NAL_SPS, NAL_PPS, NAL_AUD))

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
nal_type = H264.nal_type
parameter_sets = H264.parameter_sets
packetize = H264.packetize
parse_payload = H264.parse_payload
