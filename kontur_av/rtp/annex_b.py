"""NAL units in an Annex B byte stream (ITU-T H.264 B.1, ITU-T H.265 B.2)."""

from collections.abc import Iterable

_START_CODE = b"\x00\x00\x00\x01"


def split_annex_b(stream: bytes) -> list[bytes]:
    """Return the NAL units of an Annex B byte stream (ITU-T H.264 B.1), without start codes.

    Octets before the first start code and zeros after a NAL unit belong to none.
    """
    units = []
    start = stream.find(b"\x00\x00\x01")
    while start != -1:
        start += 3
        end = stream.find(b"\x00\x00\x01", start)
        unit = stream[start:] if end == -1 else stream[start:end]
        unit = unit.rstrip(b"\x00")
        if unit:
            units.append(unit)
        start = end
    return units


def join_annex_b(nal_units: Iterable[bytes]) -> bytes:
    """Return an Annex B byte stream of `nal_units`, each behind a start code of 4 octets."""
    return b"".join(_START_CODE + unit for unit in nal_units)
