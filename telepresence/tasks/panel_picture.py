"""The LED panel's datagram: its whole state, and the acknowledgement.

The sender repeats the newest state ten times a second. A datagram says all, so any one may be lost,
repeated or late. All numbers are big-endian.

| octets | state | acknowledgement |
|---|---|---|
| 0 | 0x4c, "L" | 0x41, "A" |
| 1 | version, 1 | version, 1 |
| 2..5 | sequence number, unsigned, grows with each new state | that of the state shown |
| 6 | pattern: 0 dark, 1 LEDs, 2 spot, 3 contour, 4 line, 5 spring, 6 free | |
| 7 | mask of the LEDs, bit 0 for LED 0 | |
| 8..10 | colour: red, green, blue | |
| 11..14 | place of the spot, x and y, signed, in units of 10 µm | |
| the last 2 | CRC-16 of all before: polynomial 0x1021, initial value 0xffff, as CCSDS uses it | |

What a pattern does not use is 0.
"""

import struct
from binascii import crc_hqx
from dataclasses import dataclass

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ProtocolError
from telepresence.tasks.definitions import Pattern

STATE_OCTETS = 17
ACKNOWLEDGEMENT_OCTETS = 8
#: The sender repeats its state after this time; the panel goes dark after that one.
REPEAT_NS = 100 * NS_PER_MS
SILENCE_NS = 2 * NS_PER_S
#: After this long without a new state, an older number is one of a sender that restarted.
_RESTART_NS = NS_PER_S // 2

_PATTERNS = tuple(Pattern)
_STATE = struct.Struct(">BBIBBBBBhh")
_ACKNOWLEDGEMENT = struct.Struct(">BBI")
_CHECK = struct.Struct(">H")
_SPOT_M = 1e-5
_NUMBERS = 1 << 32
_LETTERS = (0x4C, 0x41)
_VERSION = 1

Rgb = tuple[int, int, int]
_WHITE: Rgb = (255, 244, 214)


@dataclass(frozen=True, slots=True)
class PanelPicture:
    """What the panel shows. leds: a mask. spot_m: place of the spot. colour: of what is lit."""

    pattern: Pattern = Pattern.DARK
    leds: int = 0
    spot_m: tuple[float, float] = (0.0, 0.0)
    colour: Rgb = _WHITE


DARK = PanelPicture(colour=(0, 0, 0))


def pack_picture(number: int, picture: PanelPicture) -> bytes:
    """Return the datagram of `picture`; `number` wraps after 2^32."""
    leds = picture.leds & 0xFF if picture.pattern is Pattern.LEDS else 0
    x, y = picture.spot_m if picture.pattern is Pattern.SPOT else (0.0, 0.0)
    colour = picture.colour if picture.pattern is not Pattern.DARK else (0, 0, 0)
    spot = (max(-32767, min(32767, round(value / _SPOT_M))) for value in (x, y))
    octets = _STATE.pack(
        _LETTERS[0],
        _VERSION,
        number % _NUMBERS,
        _PATTERNS.index(picture.pattern),
        leds,
        *colour,
        *spot,
    )
    return octets + _CHECK.pack(crc_hqx(octets, 0xFFFF))


def parse_picture(octets: bytes) -> tuple[int, PanelPicture]:
    """Return number and state; ProtocolError unless `octets` are exactly one state."""
    _check(octets, STATE_OCTETS, _LETTERS[0])
    _, _, number, index, leds, *rest = _STATE.unpack_from(octets)
    red, green, blue, x, y = rest
    if index >= len(_PATTERNS) or -32768 in (x, y):
        raise ProtocolError("LED panel: no such pattern or place")
    pattern = _PATTERNS[index]
    used = {Pattern.LEDS: not (x or y), Pattern.SPOT: not leds}
    if not used.get(pattern, not (leds or x or y)):
        raise ProtocolError(f"LED panel: {pattern} with values that it does not use")
    colour = (red, green, blue)
    if pattern is Pattern.DARK and any(colour):
        raise ProtocolError("LED panel: dark, with a colour")
    return number, PanelPicture(pattern, leds, (x * _SPOT_M, y * _SPOT_M), colour)


def pack_acknowledgement(number: int) -> bytes:
    """Return the datagram that says: the state `number` is shown."""
    octets = _ACKNOWLEDGEMENT.pack(_LETTERS[1], _VERSION, number % _NUMBERS)
    return octets + _CHECK.pack(crc_hqx(octets, 0xFFFF))


def parse_acknowledgement(octets: bytes) -> int:
    """Return the number of the state that is shown; ProtocolError."""
    _check(octets, ACKNOWLEDGEMENT_OCTETS, _LETTERS[1])
    number: int = _ACKNOWLEDGEMENT.unpack_from(octets)[2]
    return number


def _check(octets: bytes, length: int, letter: int) -> None:
    if len(octets) != length:
        raise ProtocolError(f"LED panel: {len(octets)} octets instead of {length}")
    if octets[0] != letter or octets[1] != _VERSION:
        raise ProtocolError("LED panel: another kind or version")
    if crc_hqx(octets, 0xFFFF):
        raise ProtocolError("LED panel: wrong check")


class PanelSender:
    """The end of the kernel: repeats the newest state, and knows which one is shown. A core.

    After `show` and at `poll_timeout`, send what `poll_transmit` returns until it is None.

    picture: the newest state. garbage: datagrams that are not an acknowledgement.
    first_number: later starts of this end begin above it, for example with the time in 0.1 s.
    """

    def __init__(self, *, first_number: int = 0) -> None:
        self.picture = DARK
        self.garbage = 0
        self._number = first_number % _NUMBERS
        self._shown: int | None = None
        self._due_ns: int | None = None

    @property
    def shown(self) -> bool:
        """Whether the panel has acknowledged the newest state."""
        return self._shown == self._number

    def show(self, picture: PanelPicture, now_ns: int) -> None:
        """Show `picture` from now on. The same one again changes nothing."""
        if picture != self.picture:
            self.picture = picture
            self._number = (self._number + 1) % _NUMBERS
            self._due_ns = now_ns

    def handle_datagram(self, octets: bytes, now_ns: int) -> None:
        """A datagram of the panel. Garbage is counted; this never raises."""
        try:
            self._shown = parse_acknowledgement(octets)
        except ProtocolError:
            self.garbage += 1

    def poll_transmit(self, now_ns: int) -> bytes | None:
        """Return the datagram to send now, or None."""
        if self._due_ns is not None and now_ns < self._due_ns:
            return None
        self._due_ns = now_ns + REPEAT_NS
        return pack_picture(self._number, self.picture)

    def poll_timeout(self) -> int | None:
        """When to call `poll_transmit` next; None: at once."""
        return self._due_ns


class LedPanel:
    """The panel's end: shows the newest state, acknowledges each, is dark after 2 s of silence.

    After `handle_datagram` send what `poll_transmit` returns until it is None. A core.

    garbage: datagrams that are not a state. late: states older than the one shown.
    """

    def __init__(self) -> None:
        self.garbage = 0
        self.late = 0
        self._picture = DARK
        self._number: int | None = None
        self._newest_ns = 0
        self._answer: bytes | None = None

    def picture(self, now_ns: int) -> PanelPicture:
        """What the panel shows at `now_ns`."""
        heard = self._number is not None and now_ns - self._newest_ns < SILENCE_NS
        return self._picture if heard else DARK

    def handle_datagram(self, octets: bytes, now_ns: int) -> None:
        """A datagram arrived. Garbage is counted; this never raises."""
        try:
            number, picture = parse_picture(octets)
        except ProtocolError:
            self.garbage += 1
            return
        if self._number is not None:
            ahead = (number - self._number) % _NUMBERS
            # A sender that restarted may begin anywhere. It is heard when the old one is silent.
            if ahead >= _NUMBERS // 2 and now_ns - self._newest_ns < _RESTART_NS:
                self.late += 1
                return
        self._number, self._picture, self._newest_ns = number, picture, now_ns
        self._answer = pack_acknowledgement(number)

    def poll_transmit(self, now_ns: int) -> bytes | None:
        """Return the acknowledgement to send, or None."""
        answer, self._answer = self._answer, None
        return answer
