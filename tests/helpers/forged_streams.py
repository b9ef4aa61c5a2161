"""Access units of H.264 and HEVC, written bit by bit, that say what no encoder would."""

from kontur_av.rtp.annex_b import join_annex_b


class Bits:
    """Fields of a NAL unit, one after the other; see the clauses 7.2 of both standards."""

    def __init__(self):
        self._bits = ""

    def u(self, *fields):
        """Append (value, bits) fields."""
        for value, bits in fields:
            self._bits += f"{value:0{bits}b}" if bits else ""
        return self

    def flags(self, text):
        self._bits += text
        return self

    def ue(self, *values):
        for value in values:
            code = f"{value + 1:b}"
            self._bits += "0" * (len(code) - 1) + code
        return self

    def aligned(self):
        self._bits += "1" + "0" * (-(len(self._bits) + 1) % 8)
        return self

    def nal(self, header):
        self.aligned()
        raw = int(self._bits, 2).to_bytes(len(self._bits) // 8, "big")
        return header + escaped(raw)


def escaped(raw):
    """Return an RBSP with emulation prevention (ITU-T H.264 clause 7.4.1)."""
    out, zeros = bytearray(), 0
    for octet in raw:
        if zeros >= 2 and octet <= 3:
            out.append(3)
            zeros = 0
        out.append(octet)
        zeros = 0 if octet else zeros + 1
    return bytes(out)


_SOME_SLICE = (0x5A5A5A5A5A5A5A5A, 64)


def sps(codec, width, height, *, chroma=1, bits=8, number=0, profile=244, layers=1):
    """Return an SPS that permits 16 pictures; h264 rounds the size down to macroblocks."""
    told = Bits()
    if codec == "h264":
        told.u((profile, 8), (0, 8), (62, 8)).ue(number)
        if profile in (100, 110, 122, 244):
            told.ue(chroma).flags("0" * (chroma == 3)).ue(bits - 8, bits - 8).flags("00")
        told.ue(0, 2, 16).flags("1").ue(width // 16 - 1, height // 16 - 1).flags("1100")
        return told.nal(b"\x67")
    told.u((0, 4), (layers - 1, 3), (1, 1), (4, 8), (0x0FFFFFFF, 32), (0, 48), (183, 8))
    if layers > 1:
        told.flags("11" * (layers - 1)).u((0, 2 * (9 - layers)), (0, 96 * (layers - 1)))
    told.ue(number, chroma).flags("0" * (chroma == 3)).ue(width, height).flags("0")
    told.ue(bits - 8, bits - 8, 4).flags("0").ue(15, 0, 0, 0, 3, 0, 3, 0, 0)
    return told.flags("0000").ue(0).flags("00000").nal(b"\x42\x01")


def other_sets(codec, number=0):
    """Return a PPS, and for HEVC the VPS, too."""
    if codec == "h264":
        pps = Bits().ue(number, number).flags("00").ue(0, 15, 0).flags("000").ue(0, 0, 0)
        return [pps.flags("000").nal(b"\x68")]
    vps = Bits().u((0x0C0DFFFF, 32), (4, 8), (0x0FFFFFFF, 32), (0, 48), (183, 8), (0, 16))
    vps.flags("0").ue(15, 0, 0).u((0, 6)).ue(0).flags("00")
    pps = Bits().ue(number, number).flags("0000000").ue(0, 0, 0).flags("000").ue(0, 0)
    pps.flags("0" * 10).ue(0).flags("00")
    return [vps.nal(b"\x40\x01"), pps.nal(b"\x44\x01")]


def first_slice(codec, number, sets=0):
    """Return a slice of picture `number` that refers to all pictures before it; 0: IDR.

    sets: number of its PPS.
    """
    if codec == "h264":
        told = Bits().ue(0, 5 if number else 7, sets).u((number & 15, 4))
        told.flags("000") if number else told.ue(0).flags("00")
        return told.ue(0).u(_SOME_SLICE).nal(b"\x41" if number else b"\x65")
    told = Bits().flags("1" if number else "10").ue(sets, 1 if number else 2)
    if number:
        referred = min(number, 15)
        told.u((number & 255, 8)).flags("0").ue(referred, 0)
        told.flags("11" * referred + "0").ue(0)
    return (
        told.ue(0).flags("1").aligned().u(_SOME_SLICE).nal(b"\x02\x01" if number else b"\x26\x01")
    )


def access_units(codec, width, height, count=20, **said):
    """Return access units of which the first is a key picture with all parameter sets."""
    sets = [*other_sets(codec)[:-1], sps(codec, width, height, **said), other_sets(codec)[-1]]
    return [
        join_annex_b([*(() if number else sets), first_slice(codec, number)])
        for number in range(count)
    ]
