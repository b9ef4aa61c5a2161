"""Every camera and stream of a recording as a Matroska file, sound with its picture. A shell."""

from pathlib import Path

from kontur_av.errors import ConfigError, ProtocolError
from kontur_av.media import AUDIO_CLOCK_HZ, BLOCK_SAMPLES
from pipelines.recording.export.columns import table_names
from pipelines.recording.export.film import FilmClock, FilmUnit, FilmUnits, can_begin, heard_ns
from pipelines.recording.joined import FAR_NS, JoinedMessage, JoinedRecording
from pipelines.recording.matroska import MatroskaFile
from pipelines.recording.messages import AUDIO, VIDEO, RecordedSound, unpack
from pipelines.recording.recording_file import Outputs

_FACTS = "/facts"
_MS_HZ = 1000
_SOUND_MS = BLOCK_SAMPLES * _MS_HZ // AUDIO_CLOCK_HZ


class MatroskaExport:
    """A file for each camera and stream, in one directory; all begin at the same instant.

    Call `begin`, then `handle_message` for each message, then `end`.

    Raises ConfigError for a recording without pictures and sound.
    """

    def __init__(self, directory: Path, recording: JoinedRecording) -> None:
        self._directory = directory
        channels = {
            channel.topic: channel.schema
            for part in recording.parts
            for channel in part.inventory.channels
            if channel.messages
        }
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
            facts = f"{topic}{_FACTS}" in channels
            name = f"{names[topic]}.mkv"
            self._films.append(Film(directory / name, topic, sound, begin_ns, facts=facts))
        shown = {film.sound for film in self._films}
        for topic in sounds:
            if topic not in shown:
                name = f"{names[topic]}.mka"
                self._films.append(Film(directory / name, None, topic, begin_ns, facts=False))
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
        self, path: Path, picture: str | None, sound: str | None, begin_ns: int, *, facts: bool
    ) -> None:
        self.path = path
        self.picture, self.sound = picture, sound
        self._units = FilmUnits(with_facts=facts)
        self._picture_clock, self._sound_clock = FilmClock(begin_ns), FilmClock(begin_ns)
        self._file: MatroskaFile | None = None
        #: Sound from before the first picture: all streams are declared before the first packet.
        self._waiting: list[tuple[int, bytes]] = []
        self._early = self._unreadable = self._pictures = self._packets = 0

    @property
    def topics(self) -> list[str]:
        """The channels that it takes."""
        facts = None if self.picture is None else f"{self.picture}{_FACTS}"
        return [topic for topic in (self.picture, facts, self.sound) if topic is not None]

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
                take = self._units.handle_picture if is_picture else self._units.handle_facts
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
