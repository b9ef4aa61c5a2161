"""A black key picture, written bit by bit (ITU-T H.264), so that nobody waits for an encoder."""

from kontur_av.codecs.colours import BT601
from kontur_av.media import BLACK_LUMA, NEUTRAL_CHROMA, check_size
from kontur_av.rtp.annex_b import join_annex_b

_SPS, _PPS, _IDR = b"\x67", b"\x68", b"\x65"
_HIGH = 100
#: By its number: the most macroblocks in a picture (table A-1).
_LEVELS = {30: 1620, 40: 8192, 51: 36_864, 62: 139_264}
#: Intra_16x16 with DC prediction (table 7-11) and the same of chroma; no change of the quantiser.
_LIKE_NEIGHBOURS = "00100" + "1" + "1"
#: coeff_token without coefficients, by the number of coefficients beside it (table 9-5).
_NONE_BESIDE_NONE, _NONE_BESIDE_16 = "1", "000011"


def black_key(width: int, height: int) -> bytes:
    """Return an access unit with one black IDR picture, with SPS and PPS (Annex B).

    Raises ConfigError for a size that no picture can have.
    """
    check_size(width, height)
    columns, rows = -(-width // 16), -(-height // 16)
    crop = (columns * 16 - width) // 2, (rows * 16 - height) // 2
    level = next(level for level, most in _LEVELS.items() if columns * rows <= most)
    return join_annex_b(
        [
            _SPS + _escaped(_closed(_sequence(level, columns, rows, crop))),
            _PPS + _escaped(_closed(_PICTURE)),
            _IDR + _escaped(_slice(columns, rows)),
        ]
    )


def _ue(value: int) -> str:
    """Exp-Golomb (clause 9.1)."""
    code = f"{value + 1:b}"
    return "0" * (len(code) - 1) + code


def _sequence(level: int, columns: int, rows: int, crop: tuple[int, int]) -> str:
    """seq_parameter_set_data (clause 7.3.2.1.1). The pictures come in the order of display."""
    cropped = "0" if crop == (0, 0) else "1" + _ue(0) + _ue(crop[0]) + _ue(0) + _ue(crop[1])
    restriction = "1" + _ue(0) + _ue(0) + _ue(9) + _ue(9) + _ue(0) + _ue(1)
    return "".join(
        [
            *(f"{_HIGH:08b}", "0" * 8, f"{level:08b}", _ue(0)),
            *(_ue(1), _ue(0), _ue(0), "00"),  # 4:2:0, 8 bits, no scaling lists
            *(_ue(0), _ue(2), _ue(1), "0"),  # frame_num, pic_order_cnt_type, one reference
            *(_ue(columns - 1), _ue(rows - 1), "11", cropped),
            # VUI: colours by BT.601 in narrow range, as all our streams say; nothing is held back.
            *("1", "00", "1", "101", "01", f"{BT601:08b}" * 3, "0" * 5, "1", restriction),
        ]
    )


#: pic_parameter_set_rbsp (clause 7.3.2.2): CAVLC, one slice, a slice may leave out deblocking.
_PICTURE = "".join([_ue(0) * 2, "00", _ue(0) * 3, "000", _ue(0) * 3, "100"])


def _slice(columns: int, rows: int) -> bytes:
    """The only slice: one macroblock as plain samples, and all others like their neighbours."""
    head = _ue(0) + _ue(7) + _ue(0) + "0000" + _ue(0) + "00" + _ue(0) + _ue(1)
    head += _ue(25)  # I_PCM, which begins at a whole octet
    head += "0" * (-len(head) % 8)
    samples = bytes([BLACK_LUMA] * 256 + [NEUTRAL_CHROMA] * 128)
    rest = [_LIKE_NEIGHBOURS + _NONE_BESIDE_NONE] * (columns * rows - 1)
    # The macroblocks right of the plain one and below it.
    for beside in {1 if columns > 1 else columns, columns}:
        if beside <= len(rest):
            rest[beside - 1] = _LIKE_NEIGHBOURS + _NONE_BESIDE_16
    return _octets(head) + samples + _closed("".join(rest))


def _octets(bits: str) -> bytes:
    return int(bits, 2).to_bytes(len(bits) // 8, "big")


def _closed(bits: str) -> bytes:
    """With rbsp_trailing_bits (clause 7.3.2.11)."""
    bits += "1"
    return _octets(bits + "0" * (-len(bits) % 8))


def _escaped(octets: bytes) -> bytes:
    """With emulation prevention (clause 7.4.1)."""
    found = bytearray()
    for octet in octets:
        if octet <= 3 and found[-2:] == b"\0\0":
            found.append(3)
        found.append(octet)
    return bytes(found)
