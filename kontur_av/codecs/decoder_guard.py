"""What a stream may ask of a decoder: its parameter sets are read before the decoder sees them.

A decoder takes memory for what a sequence parameter set (SPS) says: up to 17 pictures. Measured of
FFmpeg with a forged SPS, 4096x4096 in 4:4:4 of 12 bits and more: 2 GB, and 0.4 s a picture.
"""

from collections.abc import Mapping
from typing import Final, NamedTuple

from kontur_av.errors import ProtocolError
from kontur_av.media import VideoCodec
from kontur_av.rtp.annex_b import join_annex_b, split_annex_b
from kontur_av.rtp.nal_formats import NAL_FORMATS

#: Of one decoded picture: 4096x2160 in 4:2:2 of 10 bits, as cameras for film have it.
MOST_PICTURE_OCTETS: Final = 4096 * 2160 * 2 * 2

_MOST_PIXELS = 4096 * 4096
#: Lines of a few pixels take as much memory as long ones, so there may not be many.
_MOST_SIDE = 8192
#: Of an access unit: NAL units, and octets of SEI. Measured: for 4 MB of small SEI messages FFmpeg
#: takes 350 MB and 3 s.
_MOST_NAL_UNITS, _MOST_SEI = 4096, 16 << 10
#: SPS of an access unit: H.264 has 32 numbers for them, HEVC 16.
_MOST_SETS = 32
_SEI: Mapping[VideoCodec, frozenset[int]] = {"h264": frozenset((6,)), "h265": frozenset((39, 40))}
#: Takes the place of a type.
_OTHER_VIEW = -1
#: An SPS is longer only if it is forged.
_MOST_SPS_OCTETS = 4096
#: Profiles of H.264 whose SPS tells colours, depth and scaling lists (clause 7.3.2.1.1). FFmpeg
#: reads the SPS of all others without them; those of depth maps differ, and are no streams here.
_HIGH = frozenset((44, 83, 86, 100, 110, 118, 122, 128, 144, 244))
_DEPTH_MAPS = frozenset((134, 135, 138, 139))


class CodedPicture(NamedTuple):
    """The pictures of an SPS. width, height: in which they are coded, before cropping.

    chroma: chroma_format_idc, from 0 (grey) to 3 (4:4:4). bits: of the deeper of luma and chroma.
    """

    width: int
    height: int
    chroma: int
    bits: int

    @property
    def octets(self) -> int:
        """Of one decoded picture. Grey counts as 4:2:0."""
        samples = self.width * self.height * (3, 3, 4, 6)[self.chroma] // 2
        return samples * (1 if self.bits <= 8 else 2)


class FrameNumbers(NamedTuple):
    """How an SPS of H.264 has slices number their pictures.

    bits: of frame_num. order: pic_order_cnt_type. kept: max_num_ref_frames.
    """

    bits: int
    order: int
    kept: int


class _Bits:
    def __init__(self, data: bytes) -> None:
        data = data[:_MOST_SPS_OCTETS]
        self._bits = f"{int.from_bytes(data):0{8 * len(data)}b}" if data else ""
        self._at = 0

    def u(self, count: int) -> int:
        found = self._bits[self._at : self._at + count]
        self._at += count
        if len(found) < count:
            raise ProtocolError("an SPS that is cut")
        return int(found or "0", 2)

    def ue(self, most: int = (1 << 32) - 2) -> int:
        """Read ue(v) (ITU-T H.264 clause 9.1, H.265 clause 9.2); ProtocolError beyond `most`."""
        one = self._bits.find("1", self._at)
        zeros = one - self._at
        if one < 0 or zeros > 32:
            raise ProtocolError("an SPS that is cut")
        self._at = one
        value = self.u(zeros + 1) - 1
        if value > most:
            raise ProtocolError(f"an SPS with {value}: at most {most}")
        return value

    def se(self) -> int:
        code = self.ue()
        return (code + 1) // 2 * (1 if code % 2 else -1)


def read_sps(nal_unit: bytes, codec: VideoCodec) -> CodedPicture:
    """Return the pictures of an SPS with its header; ProtocolError if it is malformed."""
    # No NAL unit has these octets; FFmpeg ends at them.
    body = nal_unit[NAL_FORMATS[codec].header_octets :].split(b"\0\0\2")[0]
    plain = body.replace(b"\0\0\3", b"\0\0")
    if codec == "h265":
        return _read_h265(_Bits(plain))
    found = _read_h264(_Bits(plain))[0]
    if plain != body:
        # FFmpeg reads an SPS again with its escapes, if it cannot without.
        try:
            return max(found, _read_h264(_Bits(body))[0], key=lambda one: one.octets)
        except ProtocolError:
            pass
    return found


def read_frame_numbers(sps: bytes) -> FrameNumbers:
    """Return what an SPS of H.264 says of frame_num; ProtocolError if it is malformed."""
    if not sps or sps[0] & 0x1F != 7:
        raise ProtocolError("not an SPS of H.264")
    return _read_h264(_Bits(sps[1:].replace(b"\0\0\3", b"\0\0")))[1]


def read_frame_num(nal_unit: bytes, size: int) -> int:
    """Return frame_num, of `size` bits, of a slice of H.264 (clause 7.3.3); ProtocolError."""
    # The fields before it take 16 octets at most.
    bits = _Bits(nal_unit[1:32].replace(b"\0\0\3", b"\0\0"))
    for _ in ("first_mb_in_slice", "slice_type", "pic_parameter_set_id"):
        bits.ue()
    return bits.u(size)


def _read_h264(bits: _Bits) -> tuple[CodedPicture, FrameNumbers]:
    """Read seq_parameter_set_data (ITU-T H.264 clause 7.3.2.1.1) up to the size."""
    profile, chroma, depth = bits.u(8), 1, 8
    bits.u(16)
    bits.ue(31)
    if profile in _DEPTH_MAPS:
        raise ProtocolError(f"an SPS of profile {profile}")
    if profile in _HIGH:
        chroma = bits.ue(3)
        if chroma == 3:
            bits.u(1)
        depth = 8 + max(bits.ue(6), bits.ue(6))
        bits.u(1)
        if bits.u(1):
            for number in range(12 if chroma == 3 else 8):
                if bits.u(1):
                    _pass_scaling_list(bits, 16 if number < 6 else 64)
    number_bits = bits.ue(12) + 4
    if (order := bits.ue(2)) == 0:
        bits.ue(12)
    elif order == 1:
        bits.u(1)
        bits.se()
        bits.se()
        for _ in range(bits.ue(255)):
            bits.se()
    kept = bits.ue(16)
    bits.u(1)
    width, rows = bits.ue() + 1, bits.ue() + 1
    frames_only = bits.u(1)
    picture = CodedPicture(16 * width, 16 * rows * (2 - frames_only), chroma, depth)
    return picture, FrameNumbers(number_bits, order, kept)


def _pass_scaling_list(bits: _Bits, count: int) -> None:
    """Pass over scaling_list (ITU-T H.264 clause 7.3.2.1.1.1)."""
    last = following = 8
    for _ in range(count):
        if following:
            following = (last + bits.se()) & 0xFF
        last = following or last


def _read_h265(bits: _Bits) -> CodedPicture:
    """Read seq_parameter_set_rbsp (ITU-T H.265 clause 7.3.2.2.1) up to the depth."""
    bits.u(4)
    layers = bits.u(3)
    if layers > 6:
        raise ProtocolError("an SPS with more than 7 temporal layers")
    bits.u(1 + 88 + 8)
    present = [(bits.u(1), bits.u(1)) for _ in range(layers)]
    if layers:
        bits.u(2 * (8 - layers))
    for profile, level in present:
        bits.u(88 * profile + 8 * level)
    bits.ue(15)
    chroma = bits.ue(3)
    if chroma == 3:
        bits.u(1)
    width, height = bits.ue(), bits.ue()
    if bits.u(1):
        for _ in range(4):
            bits.ue()
    depth = 8 + max(bits.ue(8), bits.ue(8))
    return CodedPicture(width, height, chroma, depth)


class DecoderGuard:
    """Stands before a decoder of one stream, and counts what it refuses.

    most_octets: of one decoded picture.
    """

    def __init__(self, codec: VideoCodec, most_octets: int = MOST_PICTURE_OCTETS) -> None:
        self._codec, self._form, self._most_octets = codec, NAL_FORMATS[codec], most_octets
        self._closed = False
        #: SPS that were malformed, or whose pictures are too large.
        self.sets_refused = 0

    def admit(self, access_unit: bytes) -> bytes:
        """Return what a decoder may have of an access unit (Annex B); b"" if nothing.

        After an SPS that is refused, nothing may pass before one that is not: it may be coded with
        the refused one.
        """
        nals = split_annex_b(access_unit)
        if len(nals) > _MOST_NAL_UNITS:
            return b""
        kinds = [self._kind(nal) for nal in nals]
        sets = [nal for nal, kind in zip(nals, kinds, strict=True) if kind == self._form.sps]
        if sets:
            many = len(sets) > _MOST_SETS
            refused = len(sets) if many else sum(not self._fits(nal) for nal in sets)
            self.sets_refused += refused
            self._closed = refused > 0
        if self._closed:
            return b""
        left_out = {_OTHER_VIEW}
        sei = _SEI[self._codec]
        if sum(len(nal) for nal, kind in zip(nals, kinds, strict=True) if kind in sei) > _MOST_SEI:
            left_out |= sei
        if left_out.isdisjoint(kinds):
            return access_unit
        return join_annex_b(
            nal for nal, kind in zip(nals, kinds, strict=True) if kind not in left_out
        )

    def _kind(self, nal: bytes) -> int:
        """Return its type; `_OTHER_VIEW` if it is of another view or layer, which nobody shows."""
        layered = self._codec == "h265" and (nal[0] & 1 or nal[1:2] > b"\x07")
        return _OTHER_VIEW if layered else self._form.nal_type(nal)

    def _fits(self, sps: bytes) -> bool:
        try:
            picture = read_sps(sps, self._codec)
        except ProtocolError:
            return False
        return (
            picture.octets <= self._most_octets
            and picture.width * picture.height <= _MOST_PIXELS
            and max(picture.width, picture.height) <= _MOST_SIDE
        )
