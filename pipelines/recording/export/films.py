"""Every camera and stream of a recording as a Matroska file, sound with its picture. A shell."""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.codecs.healing import recovery_pictures
from kontur_av.codecs.opus import LOOKAHEAD_SAMPLES
from kontur_av.errors import ConfigError, ProtocolError
from kontur_av.media import AUDIO_CLOCK_HZ, BLOCK_SAMPLES, VideoCodec
from kontur_av.rtp.annex_b import split_annex_b
from kontur_av.rtp.nal_formats import NAL_FORMATS
from kontur_av.sources.instants import RisingInstants
from pipelines.recording.channels import SENT
from pipelines.recording.export.columns import table_names
from pipelines.recording.joined import FAR_NS, JoinedMessage, JoinedRecording
from pipelines.recording.matroska import MatroskaFile
from pipelines.recording.recorded_messages import (
    AUDIO,
    VIDEO,
    RecordedPicture,
    RecordedSound,
    UnitMetadata,
    unpack,
)
from pipelines.recording.recording_file import Outputs


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

    with_metadata: the channel has facts, each directly behind its unit.
    """

    def __init__(self, *, with_metadata: bool) -> None:
        self._with_metadata = with_metadata
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
        if not self._with_metadata:
            yield from self.handle_end()

    def handle_capabilities(self, message: JoinedMessage) -> Iterator[FilmUnit]:
        held = self._held
        try:
            metadata = unpack(UnitMetadata, message.data)
        except ProtocolError:
            return
        if held is None or held[0].sequence != message.sequence:
            return
        if metadata.added:
            # Its number is that of the unit before the one that follows.
            self._bridged = self._newest == message.sequence
            if self._bridged:
                self._held = None
        else:
            picture, data = held
            if self._bridged and 0 < metadata.octets < len(data):
                self._held = picture, data[-metadata.octets :]
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


_METADATA = "/facts"
_MS_HZ = 1000
_SOUND_MS = BLOCK_SAMPLES * _MS_HZ // AUDIO_CLOCK_HZ


class MatroskaExport:
    """A file for each camera and stream, in one directory; all begin at the same instant.

    Call `begin`, then `handle_message` for each message, then `end`.

    Raises ConfigError for a recording without pictures and sound.
    """

    def __init__(self, directory: Path, recording: JoinedRecording) -> None:
        self._directory = directory
        channels = recording.schemas
        pictures = [topic for topic, schema in channels.items() if schema == VIDEO.full_name]
        sounds = [topic for topic, schema in channels.items() if schema == AUDIO.full_name]
        if not pictures and not sounds:
            raise ConfigError("the recording has neither pictures nor sound: leave out --mkv")
        names = table_names([*pictures, *sounds])
        begin_ns, first_ns = recording.begin_ns, recording.first_ns([*pictures, *sounds])
        if begin_ns - first_ns <= FAR_NS:
            begin_ns = min(begin_ns, first_ns)
        self._films: list[Film] = []
        for topic in pictures:
            voice = topic.replace("_video/", "_voice/")
            sound = voice if voice in sounds else None
            metadata = f"{topic}{_METADATA}" in channels
            name = f"{names[topic]}.mkv"
            self._films.append(Film(directory / name, topic, sound, begin_ns, metadata=metadata))
        shown = {film.sound for film in self._films}
        for topic in sounds:
            if topic not in shown:
                name = f"{names[topic]}.mka"
                self._films.append(Film(directory / name, None, topic, begin_ns, metadata=False))
        self._takers: dict[str, list[Film]] = {}
        for film in self._films:
            for topic in film.topics:
                self._takers.setdefault(topic, []).append(film)

    @property
    def paths(self) -> list[Path]:
        return [film.path for film in self._films]

    def begin(self, outputs: Outputs) -> None:
        outputs.make_directory(self._directory)
        for film in self._films:
            film.open(outputs.unfinished(film.path))

    def handle_message(self, message: JoinedMessage) -> None:
        for film in self._takers.get(message.topic, ()):
            film.handle_message(message)

    def end(self) -> None:
        for film in self._films:
            film.close()

    def lines(self) -> list[str]:
        return [line for film in self._films for line in film.lines()]


class Film:
    """One Matroska file: a channel of pictures, a channel of sound, or both.

    Pictures are written from the first one with an SPS on, because no player can show earlier ones.
    """

    def __init__(
        self, path: Path, picture: str | None, sound: str | None, begin_ns: int, *, metadata: bool
    ) -> None:
        self.path = path
        self.picture, self.sound = picture, sound
        self._units = FilmUnits(with_metadata=metadata)
        self._picture_clock, self._sound_clock = FilmClock(begin_ns), FilmClock(begin_ns)
        self._file: MatroskaFile | None = None
        #: Sound from before the first picture: all streams are declared before the first packet.
        self._waiting: list[tuple[int, bytes]] = []
        self._early = self._unreadable = self._pictures = self._packets = 0

    @property
    def topics(self) -> list[str]:
        """The channels that it takes."""
        metadata = None if self.picture is None else f"{self.picture}{_METADATA}"
        return [topic for topic in (self.picture, metadata, self.sound) if topic is not None]

    def open(self, path: Path) -> None:
        """Open the file under another name."""
        self._file = MatroskaFile(path)
        if self.picture is None:
            self._file.begin_sound()

    def handle_message(self, message: JoinedMessage) -> None:
        try:
            if message.topic == self.sound:
                self._handle_sound(message)
            else:
                is_picture = message.topic == self.picture
                take = self._units.handle_picture if is_picture else self._units.handle_capabilities
                for unit in take(message):
                    self._write_picture(unit)
        except ProtocolError:
            self._unreadable += 1

    def close(self) -> None:
        """Write what waits, and finish the file."""
        for unit in self._units.handle_end():
            self._write_picture(unit)
        assert self._file is not None
        if self._waiting and not self._file.has_video:
            self._file.begin_sound()
        self._write_waiting()
        self._file.close()

    def lines(self) -> list[str]:
        told = [
            f"{self.path}: {self._pictures} pictures"
            + (f", {self._packets} packets of sound" if self.sound else "")
            if self.picture
            else f"{self.path}: {self._packets} packets of sound"
        ]
        if self._early:
            told.append(
                f"{self.path}: {self._early} pictures before the first key picture left out"
            )
        if self._unreadable:
            told.append(f"{self.path}: {self._unreadable} messages are no pictures or sound")
        return told

    def _handle_sound(self, message: JoinedMessage) -> None:
        self._waiting.append((heard_ns(message), unpack(RecordedSound, message.data).data))
        assert self._file is not None
        if self.picture is None or self._file.has_video:
            self._write_waiting()

    def _write_waiting(self) -> None:
        assert self._file is not None
        waiting, self._waiting = self._waiting, []
        for at_ns, data in waiting:
            at_ms = self._sound_clock.instant_ms(at_ns)
            self._file.write_sound(data, at_ms, _MS_HZ, _SOUND_MS)
            self._packets += 1

    def _write_picture(self, unit: FilmUnit) -> None:
        assert self._file is not None
        if not self._file.has_video:
            if not self._file.begin_video(unit.data, unit.codec):
                self._early += 1
                return
            if self.sound is not None:
                self._file.begin_sound()
        at_ms = self._picture_clock.instant_ms(unit.session_ns)
        key = can_begin(unit)
        self._file.write_picture(unit.data, at_ms, at_ms, _MS_HZ, keyframe=key)
        self._pictures += 1
        self._write_waiting()
