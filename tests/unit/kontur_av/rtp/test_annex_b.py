"""NAL units between start codes (ITU-T H.264 annex B)."""

import pytest

from kontur_av.rtp.annex_b import split_annex_b

CODE = b"\0\0\1"


@pytest.mark.parametrize(
    ("stream", "units"),
    [
        # Start codes of both lengths, and trailing zeros.
        (b"\0" + CODE + b"\x67\x42" + CODE + b"\x68" + b"\0" + CODE + b"\x65\0", "6742 68 65"),
        # Octets before the first start code, and zeros alone, are no NAL units.
        (b"\x09" + CODE + b"\x67" + CODE + CODE + b"\0\x68", "67 0068"),
        (b"", ""),
        (b"\x41\x88", ""),
        (CODE, ""),
        (CODE + bytes(3), ""),
    ],
)
def test_octets_between_start_codes_are_nal_units(stream, units):
    assert split_annex_b(stream) == [bytes.fromhex(word) for word in units.split()]
