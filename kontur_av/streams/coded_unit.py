"""An access unit on its way through shared memory, for readers that decode it themselves."""

import struct
from dataclasses import dataclass
from typing import Self

from kontur_av.errors import ProtocolError
from kontur_av.media import VideoCodec

#: Flags, an octet without meaning, width, height, lengths of parameter sets and access unit.
_HEADER = struct.Struct("<BxHHHI")
_H265 = 16
#: By the field of the unit.
_FLAGS = {"key": 1, "damaged": 2, "refused": 4, "dated": 8, "added": 32}

#: A larger access unit is not published, so that no peer makes shared memory grow.
MOST_UNIT_OCTETS = 1 << 20


@dataclass(frozen=True, slots=True, kw_only=True)
class CodedUnit:
    """One access unit as a sample of a topic. The sample's stamp says when it was captured.

    data: a byte stream (ITU-T H.264 or H.265, Annex B), of at most `MOST_UNIT_OCTETS`.
    key: it holds a picture at which any decoder can start: IDR, or any IRAP of HEVC.
    damaged: packets of it are missing. The stamp's quality is DAMAGED also where the picture shows
        the loss of an earlier one.
    refused: the decoder returned no picture for it, or one larger than its stream permits. A reader
        shows nothing of it. An HEVC decoder needs it if it is part of a wave; others may close.
    dated: the stamp's `capture_ns` is known. False before the first sender report of a received
        stream; `capture_ns` is 0 then.
    width, height: size of its picture in pixels; 0 if it is refused.
    added: no unit of the stream, but a key picture for readers that joined. It shows what the unit
        of the same number shows. A decoder that begins with it goes on with the next number, with
        `parameter_sets` ahead of that; others pass over it.
    codec: how it is coded.
    parameter_sets: those with which it is decoded, as Annex B, for a reader that has missed
        them: they come with a key picture or a refresh wave only. b"" if they are not known.

    The `sequence` of the stamp counts the units of one start of the writer. A gap means that this
    reader missed some, or that none were published while nobody read.
    """

    data: bytes
    key: bool
    damaged: bool = False
    refused: bool = False
    dated: bool = True
    width: int = 0
    height: int = 0
    parameter_sets: bytes = b""
    added: bool = False
    codec: VideoCodec = "h264"

    def pack(self) -> bytes:
        """Return it as octets, for `Writer.publish_octets`."""
        flags = sum(flag for name, flag in _FLAGS.items() if getattr(self, name))
        flags += _H265 * (self.codec == "h265")
        sets = self.parameter_sets
        header = _HEADER.pack(flags, self.width, self.height, len(sets), len(self.data))
        return header + sets + self.data

    @classmethod
    def unpack(cls, octets: bytes) -> Self:
        """Return the unit that `pack` packed; ProtocolError for octets of another length."""
        if len(octets) < _HEADER.size:
            raise ProtocolError(f"a coded unit of {len(octets)} octets: {_HEADER.size} are least")
        flags, width, height, sets, length = _HEADER.unpack_from(octets)
        begin = _HEADER.size + sets
        data = octets[begin:]
        if len(data) != length or length > MOST_UNIT_OCTETS:
            raise ProtocolError(f"a coded unit of {length} octets in {len(data)}")
        return cls(
            data=data,
            **{name: bool(flags & flag) for name, flag in _FLAGS.items()},
            width=width,
            height=height,
            parameter_sets=octets[_HEADER.size : begin],
            codec="h265" if flags & _H265 else "h264",
        )
