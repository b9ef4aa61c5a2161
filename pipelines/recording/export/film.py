"""Pictures and sound of a recording in the order in which a player gets them. A core."""

from collections.abc import Iterator
from typing import NamedTuple

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.codecs.healing import recovery_pictures
from kontur_av.codecs.opus import LOOKAHEAD_SAMPLES
from kontur_av.errors import ProtocolError
from kontur_av.media import AUDIO_CLOCK_HZ, VideoCodec
from kontur_av.rtp.annex_b import split_annex_b
from kontur_av.rtp.nal_formats import NAL_FORMATS
from kontur_av.sources.instants import RisingInstants
from pipelines.recording.channels import SENT
from pipelines.recording.joined import JoinedMessage
from pipelines.recording.messages import RecordedPicture, UnitFacts, unpack


class FilmUnit(NamedTuple):
    """An access unit (Annex B), and the instant of its capture on the session's clock."""

    data: bytes
    session_ns: int
    codec: VideoCodec = "h264"


class FilmUnits:
    """The access units of one channel, across the parts of a recording.

    Where a part begins in the middle of a stream, the recorder put a key picture ahead, and the
    stream's parameter sets in front of the next unit. Where the part before is there, the stream
    goes on without them. After a gap they stay.

    with_facts: the channel has facts, each directly behind its unit.
    """

    def __init__(self, *, with_facts: bool) -> None:
        self._with_facts = with_facts
        self._held: tuple[JoinedMessage, bytes] | None = None
        self._codec: VideoCodec = "h264"
        self._newest: int | None = None
        self._bridged = False

    def handle_picture(self, message: JoinedMessage) -> Iterator[FilmUnit]:
        """Take a message with a picture. ProtocolError for anything else."""
        yield from self.handle_end()
        picture = unpack(RecordedPicture, message.data)
        self._held = message, picture.data
        self._codec = "h265" if picture.format == "h265" else "h264"
        if not self._with_facts:
            yield from self.handle_end()

    def handle_facts(self, message: JoinedMessage) -> Iterator[FilmUnit]:
        """Take a message with facts."""
        held = self._held
        try:
            facts = unpack(UnitFacts, message.data)
        except ProtocolError:
            return
        if held is None or held[0].sequence != message.sequence:
            return
        if facts.added:
            # Its number is that of the unit before the one that follows.
            self._bridged = self._newest == message.sequence
            if self._bridged:
                self._held = None
        else:
            picture, data = held
            if self._bridged and 0 < facts.octets < len(data):
                self._held = picture, data[-facts.octets :]
            self._bridged = False
        yield from self.handle_end()

    def handle_end(self) -> Iterator[FilmUnit]:
        """No facts follow any more: yield the unit that waits for them."""
        if self._held is None:
            return
        (message, data), self._held = self._held, None
        self._newest = message.sequence
        yield FilmUnit(data, message.session_ns, self._codec)


class FilmClock:
    """Instants of one stream in ms from `begin_ns` on. They rise with every unit.

    Before a receiver knows the sender's clock, units have the instant of their arrival. So their
    instants may step back by the delay of the link.
    """

    def __init__(self, begin_ns: int) -> None:
        self._begin_ns = begin_ns
        self._newest_ms = -1
        self._instants = RisingInstants(NS_PER_MS, most_back_ns=10 * NS_PER_S)

    def instant_ms(self, session_ns: int) -> int:
        """Return the instant of the next unit, rounded to the nearest ms."""
        rising_ns = self._instants.instant_ns(max(session_ns, self._begin_ns))
        exact_ms = (rising_ns - self._begin_ns + NS_PER_MS // 2) // NS_PER_MS
        self._newest_ms = max(exact_ms, self._newest_ms + 1)
        return self._newest_ms


def heard_ns(message: JoinedMessage) -> int:
    """When the sound was captured that one hears at the beginning of an Opus packet.

    A packet as sent has the instant of its block, which the codec's look-ahead delays. One as
    received has this instant already: its sender has told it so.
    """
    if message.topic.endswith(f"/{SENT}"):
        return message.session_ns - LOOKAHEAD_SAMPLES * NS_PER_S // AUDIO_CLOCK_HZ
    return message.session_ns


def can_begin(unit: FilmUnit) -> bool:
    """Whether a player can jump to this access unit: it has a key picture, or begins a wave."""
    form = NAL_FORMATS[unit.codec]
    key = any(form.nal_type(nal) in form.keys for nal in split_annex_b(unit.data))
    return key or recovery_pictures(unit.data, unit.codec) is not None
