"""A camera or a voice of an MCAP recording, looped, with its own times.

The messages are those of Foxglove, `foxglove.CompressedVideo` and `foxglove.CompressedAudio`, as
protobuf (https://docs.foxglove.dev/docs/sdk/schemas). Their fields are found by the schema in the
file, so recordings of other programs play, too.
"""

import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import zstandard
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.message import DecodeError
from mcap.exceptions import McapError
from mcap.reader import McapReader, make_reader
from mcap.records import Schema

from kontur_av.clock import NS_PER_S, Clock
from kontur_av.codecs.h264 import H264Decoder
from kontur_av.codecs.opus import OpusDecoder
from kontur_av.errors import ConfigError, ProtocolError
from kontur_av.media import AUDIO_CLOCK_HZ, BLOCK_NS, BLOCK_SAMPLES, Pcm
from kontur_av.recorded_format import FORMAT, FORMAT_KEY
from kontur_av.sources.fit import scaled_aspect
from kontur_av.sources.looped import LoopedAudio, LoopedVideo, PlayedPicture

#: By kind: schema and format of its messages, and what it is called.
_SCHEMAS = {
    "video": ("foxglove.CompressedVideo", "h264", "pictures"),
    "audio": ("foxglove.CompressedAudio", "opus", "sound"),
}
#: Missing sound is concealed for so many blocks. Then there is silence.
_CONCEALED = 3
#: Sound that is later than this, as a share of a block, has lost a block before it.
_LATE = Fraction(1, 2)
_FAULTS = (
    McapError,
    DecodeError,
    EOFError,
    IndexError,
    KeyError,
    OverflowError,
    RuntimeError,  # of lz4
    TypeError,
    struct.error,
    zstandard.ZstdError,
)


class _Unit(NamedTuple):
    """A message: the instant of its capture, and its access unit or Opus packet."""

    log_ns: int
    data: bytes
    format: str


def parse_place(place: str) -> tuple[str, str]:
    """Split FILE#CHANNEL; the channel is "" without one."""
    path, sharp, channel = place.rpartition("#")
    return (path, channel) if sharp else (place, "")


def check_recording(place: str, kind: Literal["video", "audio"]) -> None:
    """Raise ConfigError, with the mend, if this FILE#CHANNEL cannot be played."""
    path, channel = parse_place(place)
    schema_name, format_name, wanted = _SCHEMAS[kind]
    try:
        if Path(path).exists() and not Path(path).is_file():
            raise ConfigError(f"{path!r} is no file: write mcap:FILE#CHANNEL")
        with Path(path).open("rb") as file, _read_faults():
            reader = make_reader(file, validate_crcs=True)
            _check_format(path, reader)
            known = _channels(reader)
            found = [topic for topic, schema, messages in known if schema == schema_name]
            if channel not in found:
                raise ConfigError(_no_channel(path, channel, wanted, found, known))
            unit = next(_units(reader, channel), None)
    except FileNotFoundError:
        raise ConfigError(f"no file {path!r}: write mcap:FILE#CHANNEL") from None
    except OSError as error:
        raise ConfigError(
            f"cannot read {path!r} ({error.strerror}): give a readable file"
        ) from None
    except ValueError as error:
        raise ConfigError(
            f"{path!r} is no whole MCAP file ({error}): give a recording, after "
            "`kontur-av recover` if it is torn"
        ) from None
    if unit is None:
        raise ConfigError(f"channel {channel} of {path!r} is empty: take another one")
    if unit.format != format_name:
        raise ConfigError(
            f"channel {channel} of {path!r} is {unit.format or 'of no known format'}: "
            f"take one with {format_name}"
        )


def _check_format(path: str, reader: McapReader) -> None:
    """Refuse a recording of ours that is newer than what is known here."""
    summary = reader.get_summary()
    for channel in () if summary is None else summary.channels.values():
        found = channel.metadata.get(FORMAT_KEY, "")
        if found.isdecimal() and int(found) > FORMAT:
            raise ConfigError(
                f"{path!r} has format {found}, and this kontur-av reads up to format {FORMAT}: "
                "install a newer one"
            )


def _no_channel(
    path: str, channel: str, wanted: str, found: list[str], known: list[tuple[str, str, int]]
) -> str:
    named = f"no channel {channel!r} with {wanted}" if channel else "no channel is named"
    if not found:
        others = ", ".join(topic for topic, _, _ in known[:8]) or "none at all"
        return f"{path!r} has no channel with {wanted}: it has {others}"
    return f"{path!r}: {named}; write mcap:FILE#CHANNEL with one of {', '.join(found)}"


def _channels(reader: McapReader) -> list[tuple[str, str, int]]:
    """Topic, name of the schema and number of messages of each channel."""
    summary = reader.get_summary()
    if summary is None:
        raise ValueError("it has no summary")
    counts = {} if summary.statistics is None else summary.statistics.channel_message_counts
    found = []
    for channel in summary.channels.values():
        schema = summary.schemas.get(channel.schema_id)
        name = schema.name if schema is not None and schema.encoding == "protobuf" else ""
        found.append((channel.topic, name, counts.get(channel.id, 0)))
    return sorted(found)


def _units(reader: McapReader, channel: str) -> Iterator[_Unit]:
    """The messages of a channel in the order in which they were written: that of decoding."""
    read = None
    for schema, _, message in reader.iter_messages(topics=[channel], log_time_order=False):
        if schema is None:
            raise ValueError(f"channel {channel} has no schema")
        if read is None:
            read = _parser(schema)
        value = read(message.data)
        yield _Unit(message.log_time, bytes(value.data), str(value.format).lower())


def _parser(schema: Schema) -> Callable[[bytes], Any]:
    """What reads messages of a protobuf schema; ValueError for one that is not understood."""
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
        pool.Add(file)
    kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))
    if not {"data", "format"} <= set(kind.DESCRIPTOR.fields_by_name):
        raise ValueError(f"schema {schema.name} has no data or no format")
    parse: Callable[[bytes], Any] = kind.FromString
    return parse


@contextmanager
def _read_faults() -> Iterator[None]:
    """Whatever reading a damaged file raises becomes ValueError."""
    try:
        yield
    except _FAULTS as error:
        raise ValueError(str(error) or type(error).__name__) from None


def read_units(path: str, channel: str) -> Iterator[_Unit]:
    """Yield the units of a channel once; ValueError where the file cannot be read (on)."""
    with Path(path).open("rb") as file, _read_faults():
        yield from _units(make_reader(file, validate_crcs=True), channel)


class RecordedVideo(LoopedVideo):
    """The pictures of a channel (a `VideoSource`), captured at the recorded intervals.

    place: FILE#CHANNEL. Access units with which no decoder can start are left out. Raises
    ConfigError as `check_recording` does.
    """

    def __init__(
        self, place: str, *, name: str, width: int, height: int, fps: int, clock: Clock
    ) -> None:
        check_recording(place, "video")
        path, self._channel = parse_place(place)
        self._size = width, height
        super().__init__(path, name=name, width=width, height=height, fps=fps, clock=clock)

    def _pass(self) -> Iterator[PlayedPicture]:
        decoder = H264Decoder()
        first_ns: int | None = None
        time_ns = 0
        for unit in read_units(self._path, self._channel):
            corrupt = decoder.counts.frames_corrupt
            for picture in decoder.decode(unit.data, 0):
                first_ns = unit.log_ns if first_ns is None else first_ns
                # Instants of capture of a damaged stream can step back.
                time_ns = max(time_ns, unit.log_ns - first_ns)
                frame = picture.frame
                aspect = scaled_aspect(*self._size, frame.width, frame.height)
                yield PlayedPicture(frame, time_ns, aspect)
            if decoder.counts.frames_corrupt > corrupt:
                self._fault(ValueError("an access unit cannot be decoded"))


class RecordedAudio(LoopedAudio):
    """The sound of a channel (an `AudioSource`), with the recorded pauses.

    place: FILE#CHANNEL. Missing packets are concealed, a longer gap is silence. Raises ConfigError
    as `check_recording` does.
    """

    def __init__(self, place: str, *, name: str, clock: Clock) -> None:
        check_recording(place, "audio")
        path, self._channel = parse_place(place)
        super().__init__(path, name=name, clock=clock)

    def _pass(self) -> Iterator[Pcm]:
        decoder = OpusDecoder()
        silence = np.zeros(BLOCK_SAMPLES, np.int16)
        due_ns: int | None = None
        for unit in read_units(self._path, self._channel):
            missing = 0
            if due_ns is not None:
                missing = max(0, int((unit.log_ns - due_ns) / Fraction(BLOCK_NS) + _LATE))
            for number in range(missing):
                yield decoder.conceal(BLOCK_SAMPLES) if number < _CONCEALED else silence
            try:
                samples = decoder.decode(unit.data)
            except ProtocolError as error:
                self._fault(error)
                samples = decoder.conceal(BLOCK_SAMPLES)
            # The true instant, so that rounding does not add up.
            due_ns = unit.log_ns + len(samples) * NS_PER_S // AUDIO_CLOCK_HZ
            yield samples
