"""YUV4MPEG2, the stream format of raw pictures that FFmpeg, GStreamer and mjpegtools write.

Format: yuv4mpeg(5) of mjpegtools. A header line `YUV4MPEG2 W640 H480 F30:1 C420jpeg ...`, then for
each picture a line `FRAME ...` and the planes.
"""

from dataclasses import dataclass
from fractions import Fraction

from kontur_av.errors import ProtocolError

MAGIC = b"YUV4MPEG2 "
FRAME = b"FRAME"
#: A longer line is garbage.
LONGEST_LINE_OCTETS = 1024
LARGEST_SIDE = 8192

_SAMPLED = {"420": (2, 2), "422": (2, 1), "444": (1, 1)}
#: Colour tag -> (FFmpeg's pixel format, chroma width divisor, height divisor); 0: no chroma.
COLOURS = {
    **{tag: (f"yuv{tag}p", *divisors) for tag, divisors in _SAMPLED.items()},
    "420jpeg": ("yuv420p", 2, 2),
    "420mpeg2": ("yuv420p", 2, 2),
    "420paldv": ("yuv420p", 2, 2),
    "411": ("yuv411p", 4, 1),
    "444alpha": ("yuva444p", 1, 1),
    "mono": ("gray", 0, 0),
    # Of FFmpeg: samples of more than 8 bits, in 16 bits each, the low octet first.
    **{
        f"{tag}p{bits}": (f"yuv{tag}p{bits}le", *divisors)
        for tag, divisors in _SAMPLED.items()
        for bits in (9, 10, 12, 14, 16)
    },
    **{f"mono{bits}": (f"gray{bits}le", 0, 0) for bits in (9, 10, 12, 14, 16)},
}


@dataclass(frozen=True, slots=True)
class Y4mHeader:
    """The fields of the header line. rate_hz: None if the line says "unknown" (F0:0)."""

    width: int
    height: int
    rate_hz: Fraction | None
    aspect: Fraction
    pixel_format: str
    full_range: bool
    frame_octets: int


def parse_header(line: bytes) -> Y4mHeader:
    """Parse a header line without its newline. Raises ProtocolError."""
    if not line.startswith(MAGIC):
        raise ProtocolError("no YUV4MPEG2 header: FFmpeg writes one with -f yuv4mpegpipe")
    fields: dict[str, str] = {}
    for word in line[len(MAGIC) :].decode("ascii", "replace").split():
        fields["XCOLORRANGE" if word.startswith("XCOLORRANGE=") else word[0]] = word[1:]
    colour = fields.get("C", "420jpeg")
    if colour not in COLOURS:
        known = (tag for tag, (pixels, *_) in COLOURS.items() if not pixels.endswith("le"))
        raise ProtocolError(f"colour format C{colour} is not one of C{', C'.join(known)}")
    width, height = _side(fields.get("W")), _side(fields.get("H"))
    pixel_format, divide_x, divide_y = COLOURS[colour]
    chroma = 2 * -(-width // divide_x) * -(-height // divide_y) if divide_x else 0
    return Y4mHeader(
        width,
        height,
        _ratio(fields.get("F")),
        _ratio(fields.get("A")) or Fraction(1),
        pixel_format,
        "FULL" in fields.get("XCOLORRANGE", ""),
        (width * height * (2 if colour == "444alpha" else 1) + chroma)
        * (2 if pixel_format.endswith("le") else 1),
    )


def _side(text: str | None) -> int:
    if text is None or not text.isascii() or not text.isdigit() or len(text) > 6:
        raise ProtocolError("width or height is missing in the YUV4MPEG2 header")
    side = int(text)
    if not 2 <= side <= LARGEST_SIDE:
        raise ProtocolError(f"a side of {side} pixels is not within 2 to {LARGEST_SIDE}")
    return side


def _ratio(text: str | None) -> Fraction | None:
    above, _, below = (text or "").partition(":")
    if not (above.isascii() and above.isdigit() and below.isascii() and below.isdigit()):
        return None
    if len(above) > 9 or len(below) > 9 or not int(above) or not int(below):
        return None
    return Fraction(int(above), int(below))


@dataclass(frozen=True, slots=True)
class Y4mPicture:
    """One picture: its planes one after the other, and its header.

    octets: valid until the next call of `Y4mReader.write_view`.
    """

    header: Y4mHeader
    octets: memoryview


class Y4mReader:
    """Parses octets into pictures. A core. Garbage is counted and skipped to the next header.

    Read into `write_view()`, report the number of octets with `handle_written`, then call
    `next_event` until it returns None. When the writer leaves, call `handle_end`.
    """

    def __init__(self) -> None:
        self.header: Y4mHeader | None = None
        self.garbage_octets = 0
        self._buffer = bytearray(1 << 16)
        self._begin = 0
        self._fill = 0
        self._in_frame = False

    def write_view(self) -> memoryview:
        """Return the buffer for the next octets; never empty."""
        if self._begin:
            rest = self._buffer[self._begin : self._fill]
            self._buffer[: len(rest)] = rest
            self._begin, self._fill = 0, len(rest)
        wanted = LONGEST_LINE_OCTETS + (self.header.frame_octets if self.header else 1 << 16)
        if len(self._buffer) < wanted:
            # A new object, because a picture returned earlier may still refer to the old one.
            larger = bytearray(wanted)
            larger[: self._fill] = self._buffer[: self._fill]
            self._buffer = larger
        return memoryview(self._buffer)[self._fill :]

    def handle_written(self, octets: int) -> None:
        """`octets` octets were written to the front of `write_view()`."""
        self._fill += octets

    def handle_end(self) -> None:
        """The writer left: drop its unfinished data and expect a new header."""
        self.garbage_octets += self._fill - self._begin
        self._begin = self._fill = 0
        self.header = None
        self._in_frame = False

    def next_event(self) -> Y4mPicture | ProtocolError | None:
        """Return a picture, an error of the stream, or None if more octets are needed."""
        while True:
            if self._in_frame and self.header is not None:
                if self._fill - self._begin < self.header.frame_octets:
                    return None
                end = self._begin + self.header.frame_octets
                octets = memoryview(self._buffer)[self._begin : end]
                self._begin, self._in_frame = end, False
                return Y4mPicture(self.header, octets)
            line_end = self._buffer.find(b"\n", self._begin, self._fill)
            if line_end < 0:
                if self._fill - self._begin > LONGEST_LINE_OCTETS:
                    return self._resync("no line where a header or a picture should begin")
                return None
            if line_end - self._begin > LONGEST_LINE_OCTETS:
                return self._resync("no line where a header or a picture should begin")
            line = bytes(self._buffer[self._begin : line_end])
            if self.header is not None and line.split(b" ", 1)[0] == FRAME:
                self._in_frame = True
                self._begin = line_end + 1
                continue
            try:
                self.header = parse_header(line)
            except ProtocolError as error:
                return self._resync(str(error))
            self._begin = line_end + 1

    def _resync(self, reason: str) -> ProtocolError | None:
        """Skip to the next octets that may begin a header."""
        self.header = None
        found = self._buffer.find(MAGIC, self._begin + 1, self._fill)
        # The last octets may be the beginning of the magic word.
        target = found if found >= 0 else max(self._begin + 1, self._fill - len(MAGIC) + 1)
        self.garbage_octets += target - self._begin
        self._begin = target
        return ProtocolError(reason)
