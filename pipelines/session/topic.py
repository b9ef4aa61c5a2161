"""The declaration of a topic: its name, the type of a sample, and one sentence."""

from typing import Any, Generic, Self, TypeVar, cast

import msgspec

from kontur_av.errors import ProtocolError, refused
from kontur_av.returned import plain
from kontur_av.streams.coded_unit import CodedUnit
from telepresence.malformed import MALFORMED

T = TypeVar("T")
_ENCODER = msgspec.msgpack.Encoder(enc_hook=plain)


class OpusPacket(bytes):
    """A packet of sound (RFC 6716)."""


class PacketOctets(bytes):
    """A space packet, with its primary header (CCSDS 133.0-B-2)."""


class Topic(str, Generic[T]):
    """The name of a topic in shared memory.

    type: of a sample, which travels as MessagePack; `bytes` and its subclasses: octets as they are;
    None: pictures or sound, read by lease. what: one sample, in words.
    """

    __slots__ = ("_decoder", "type", "what")
    type: Any
    what: str
    _decoder: Any

    def __new__(cls, name: str, type: Any, what: str) -> Self:
        topic = super().__new__(cls, name)
        topic.type, topic.what, topic._decoder = type, what, None
        return topic

    def __reduce__(self) -> tuple[Any, ...]:
        return Topic, (str(self), self.type, self.what)

    @property
    def sample(self) -> str:
        """Type and words of one sample."""
        named = None if self.type in (None, bytes) else getattr(self.type, "__name__", None)
        return f"{named}: {self.what}" if named else self.what

    def pack(self, sample: T) -> bytes:
        """Return a sample as octets."""
        if isinstance(sample, CodedUnit):
            return sample.pack()
        return sample if isinstance(sample, bytes) else _ENCODER.encode(sample)

    def unpack(self, octets: bytes) -> T:
        """Return the sample of these octets; ProtocolError for anything else."""
        if isinstance(self.type, type) and issubclass(self.type, bytes):
            return cast(T, octets)
        if self.type is CodedUnit:
            return cast(T, CodedUnit.unpack(octets))
        if self._decoder is None:
            self._decoder = msgspec.msgpack.Decoder(self.type)
        with refused(self, *MALFORMED, raising=ProtocolError):
            return cast(T, self._decoder.decode(octets))


AnyTopic = Topic[Any]
