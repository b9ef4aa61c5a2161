"""What the header extension PICTURE tells of a stream: numbers of pictures, and their size."""

import struct
from collections import OrderedDict
from dataclasses import dataclass, field

from kontur_av.errors import ConfigError, ProtocolError
from kontur_av.media import check_size
from kontur_av.modular import serial_difference
from kontur_av.rtp.header_extensions import elements_of, read_picture

#: The most pictures whose numbers are remembered while they are decoded.
_REMEMBERED = 256


@dataclass(slots=True)
class _Source:
    newest: int
    size: tuple[int, int]
    #: By RTP timestamp.
    numbers: OrderedDict[int, int] = field(default_factory=OrderedDict)


class PictureMarks:
    """The numbers and the size that senders tell. A core. extension_id: of PICTURE; None: none."""

    def __init__(self, extension_id: int | None) -> None:
        self._id = extension_id
        #: By SSRC: the accepted source, and one that may follow.
        self._sources: dict[int, _Source] = {}

    def handle_packet(self, datagram: bytes, accepted: int | None) -> None:
        """Handle a packet of any source. accepted: the SSRC of the one that is received."""
        try:
            told = read_picture(elements_of(datagram).get(self._id or 0, b""))
            if told is None:
                return
            number, size = told
            if size is not None:
                check_size(*size)
        except (ProtocolError, ConfigError):
            return
        timestamp, ssrc = struct.unpack_from("!LL", datagram, 4)
        source = self._sources.get(ssrc)
        if source is None:
            if size is None:
                return
            # An unknown sender's packets must not grow this.
            self._sources = {one: of for one, of in self._sources.items() if one == accepted}
            source = self._sources[ssrc] = _Source(number, size)
        if size is None:
            number = source.newest + serial_difference(number - source.newest, 16)
        else:
            source.size = size
        source.newest = number
        source.numbers[timestamp] = number
        if len(source.numbers) > _REMEMBERED:
            source.numbers.popitem(last=False)

    def number(self, ssrc: int | None, timestamp: int) -> int | None:
        """Return the number of a picture by its RTP timestamp; None: it was not told."""
        source = self._sources.get(ssrc or 0)
        return None if source is None else source.numbers.get(timestamp)

    def size(self, ssrc: int | None) -> tuple[int, int] | None:
        """Return the size in which a source's pictures were handed over, in pixels."""
        source = self._sources.get(ssrc or 0)
        return None if source is None else source.size
