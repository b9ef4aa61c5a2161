"""A camera or a voice of an MCAP recording, looped, with its own times.

The messages are those of Foxglove, `foxglove.CompressedVideo` and `foxglove.CompressedAudio`, as
protobuf (https://docs.foxglove.dev/docs/sdk/schemas). Their fields are found by the schema in the
file, so recordings of other programs play, too.
"""

import os
import struct
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import IO, Any, Literal, NamedTuple

import numpy as np
from av.video.frame import PictureType
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.message import DecodeError
from mcap.exceptions import McapError
from mcap.reader import McapReader, make_reader
from mcap.records import Channel, Chunk, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk

from kontur_av.clock import NS_PER_S, Clock
from kontur_av.codecs.decoder import VideoDecoder
from kontur_av.codecs.opus import OpusDecoder
from kontur_av.errors import ConfigError, ProtocolError
from kontur_av.media import AUDIO_CLOCK_HZ, BLOCK_NS, BLOCK_SAMPLES, VIDEO_CODECS, Pcm, VideoCodec
from kontur_av.sources.fit import scaled_aspect
from kontur_av.sources.instants import RisingInstants
from kontur_av.sources.looped import LoopedAudio, LoopedVideo, PlayedPicture
from kontur_av.sources.recorded_format import FORMAT, FORMAT_KEY, unpacked_chunk

#: By kind: schema and format of its messages, and what it is called.
_SCHEMAS = {
    "video": ("foxglove.CompressedVideo", VIDEO_CODECS, "pictures"),
    "audio": ("foxglove.CompressedAudio", ("opus",), "sound"),
}
_NOT_PROTOBUF = ", which is not read"
#: Missing sound is concealed for this many blocks. Then there is silence.
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
    TypeError,
    struct.error,
)


class _Unit(NamedTuple):
    """A message: the instant of its capture, and its access unit or Opus packet."""

    log_ns: int
    data: bytes
    format: str


def parse_place(place: str) -> tuple[str, str]:
    """Split FILE#CHANNEL; the channel is "" without one. Both may have more of that sign."""
    places = [at for at, sign in enumerate(place) if sign == "#"]
    if not places:
        return place, ""
    # Unlike Path.exists, it raises nothing for a name that is too long.
    found = (at for at in reversed(places) if os.path.exists(place[:at]))  # noqa: PTH110
    at = next(found, places[-1])
    return place[:at], place[at + 1 :]


def check_recording(place: str, kind: Literal["video", "audio"]) -> None:
    """Raise ConfigError, with the fix, if this FILE#CHANNEL cannot be played."""
    path, channel = parse_place(place)
    schema_name, formats, wanted = _SCHEMAS[kind]
    try:
        if Path(path).exists() and not Path(path).is_file():
            raise ConfigError(f"{path!r} is no file: write mcap:FILE#CHANNEL")
        with Path(path).open("rb") as file, _read_faults():
            reader = make_reader(file, validate_crcs=True)
            _check_format(path, reader)
            known = _channels(reader, file)
            found = [topic for topic, schema, messages in known if schema == schema_name]
            if channel not in found:
                raise ConfigError(_no_channel(path, channel, wanted, found, known))
            unit = next(_units(file, channel), None)
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
    if unit.format not in formats:
        raise ConfigError(
            f"channel {channel} of {path!r} is {unit.format or 'of no known format'}: "
            f"take one with {' or '.join(formats)}"
        )
    if kind == "video" and unit.data.lstrip(b"\0")[:1] != b"\1":
        raise ConfigError(
            f"channel {channel} of {path!r} has lengths before its NAL units (AVCC): "
            "write start codes (Annex B), as foxglove.CompressedVideo wants"
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
    for topic, schema, _ in known:
        if topic == channel and schema.endswith(_NOT_PROTOBUF):
            return f"channel {channel} of {path!r} is {schema}: record it as protobuf"
    if not found:
        others = ", ".join(topic for topic, _, _ in known[:8]) or "none at all"
        return f"{path!r} has no channel with {wanted}: it has {others}"
    return f"{path!r}: {named}; write mcap:FILE#CHANNEL with one of {', '.join(found)}"


def _channels(reader: McapReader, file: IO[bytes]) -> list[tuple[str, str, int]]:
    """Topic, name of the schema and number of messages of each channel."""
    summary = reader.get_summary()
    counts: Mapping[int, int] = {}
    named = summary and {one.schema_id for one in summary.channels.values()}
    if summary is not None and named and named <= {0, *summary.schemas}:
        channels, schemas = summary.channels, summary.schemas
        if summary.statistics is not None:
            counts = summary.statistics.channel_message_counts
    else:
        channels, schemas, counts = _counted(file)
    found = []
    for channel in channels.values():
        schema = schemas.get(channel.schema_id)
        name = "" if schema is None else schema.name
        if schema is not None and schema.encoding != "protobuf":
            name += f" in {schema.encoding or 'no encoding'}{_NOT_PROTOBUF}"
        found.append((channel.topic, name, counts.get(channel.id, 0)))
    return sorted(found)


def _counted(file: IO[bytes]) -> tuple[dict[int, Channel], dict[int, Schema], Counter[int]]:
    """The channels, schemas and numbers of messages of a file whose summary has none of them."""
    file.seek(0)
    channels: dict[int, Channel] = {}
    schemas: dict[int, Schema] = {}
    counts = Counter[int]()
    for record in _records(file):
        if isinstance(record, Channel):
            channels[record.id] = record
        elif isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Message):
            counts[record.channel_id] += 1
    return channels, schemas, counts


def _units(file: IO[bytes], topic: str) -> Iterator[_Unit]:
    """The messages of a channel in the order in which they were written: that of decoding."""
    file.seek(0)
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    read = None
    for record in _records(file):
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            channels[record.id] = record
        elif isinstance(record, Message) and channels[record.channel_id].topic == topic:
            if read is None:
                read = _parser(schemas[channels[record.channel_id].schema_id])
            value = read(record.data)
            yield _Unit(record.log_time, bytes(value.data), str(value.format).lower())


def _records(file: IO[bytes]) -> Iterator[McapRecord]:
    """All records in the order of the file, those in chunks, too."""
    for record in StreamReader(file, emit_chunks=True).records:
        if not isinstance(record, Chunk):
            yield record
            continue
        plain = unpacked_chunk(record.compression, record.data, record.uncompressed_size)
        if plain is None:
            known = record.compression in ("", "lz4", "zstd")
            raise ValueError(
                "a chunk is damaged" if known else f"its compression {record.compression!r} is new"
            )
        yield from breakup_chunk(replace(record, compression="", data=plain), validate_crc=True)


def _parser(schema: Schema) -> Callable[[bytes], Any]:
    """What reads messages of a protobuf schema; ValueError for one that is not understood."""
    pool = descriptor_pool.DescriptorPool()
    try:
        files = descriptor_pb2.FileDescriptorSet.FromString(schema.data).file
        # A file may stand before those that it imports, but is added after them.
        open_files = {file.name: file for file in files}
        while ready := [
            name
            for name, file in open_files.items()
            if not any(one in open_files for one in file.dependency if one != name)
        ]:
            for name in ready:
                pool.Add(open_files.pop(name))
        kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))
    except (DecodeError, KeyError, TypeError) as error:
        raise ValueError(f"schema {schema.name} cannot be read: {error}") from None
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


def read_units(path: str, channel: str, instants: RisingInstants) -> Iterator[_Unit]:
    """Yield the units of a channel once, at rising instants; ValueError where that ends."""
    with Path(path).open("rb") as file, _read_faults():
        for unit, log_ns in instants.redate(_units(file, channel), lambda one: one.log_ns):
            yield unit._replace(log_ns=log_ns)


def _moved(channel: str, instants: RisingInstants) -> ValueError:
    return ValueError(
        f"channel {channel}: {instants.moved} instants were not after the one before or far ahead: "
        "moved"
    )


class RecordedVideo(LoopedVideo):
    """The pictures of a channel (a `VideoSource`), captured at the recorded intervals.

    place: FILE#CHANNEL. Access units with which no decoder can start are left out. Raises
    ConfigError as `check_recording` does.
    """

    check_source = staticmethod(partial(check_recording, kind="video"))

    def __init__(
        self, name: str, width: int, height: int, fps: float, clock: Clock, place: str
    ) -> None:
        self.check_source(place)
        path, self._channel = parse_place(place)
        self._size = width, height
        super().__init__(name, width, height, fps, clock, path)

    def _pass(self) -> Iterator[PlayedPicture]:
        codec: VideoCodec = "h264"
        decoder = VideoDecoder(codec)
        first_ns: int | None = None
        reordered = False
        instants = RisingInstants(self._period_ns)
        for unit in read_units(self._place, self._channel, instants):
            now: VideoCodec = "h265" if unit.format == "h265" else "h264"
            if now != codec:
                codec, decoder = now, VideoDecoder(now)
            corrupt = decoder.counts.frames_corrupt
            for picture in decoder.decode(unit.data, 0):
                first_ns = unit.log_ns if first_ns is None else first_ns
                frame = picture.frame
                reordered |= frame.pict_type == PictureType.B
                aspect = scaled_aspect(*self._size, frame.width, frame.height)
                yield PlayedPicture(frame, unit.log_ns - first_ns, aspect)
            if decoder.counts.frames_corrupt > corrupt:
                self._fault(ValueError("an access unit cannot be decoded"))
        if instants.moved:
            self._fault(_moved(self._channel, instants))
        if reordered:
            words = "has B pictures, so its instants are wrong: record it without"
            self._fault(ValueError(f"channel {self._channel} {words}"))


class RecordedAudio(LoopedAudio):
    """The sound of a channel (an `AudioSource`), with the recorded pauses.

    place: FILE#CHANNEL. Missing packets are concealed, a longer gap is silence. Raises ConfigError
    as `check_recording` does.
    """

    check_source = staticmethod(partial(check_recording, kind="audio"))

    def __init__(self, name: str, clock: Clock, place: str) -> None:
        self.check_source(place)
        path, self._channel = parse_place(place)
        super().__init__(name, clock, path)

    def _pass(self) -> Iterator[Pcm]:
        decoder = OpusDecoder()
        silence = np.zeros(BLOCK_SAMPLES, np.int16)
        due_ns: int | None = None
        instants = RisingInstants(BLOCK_NS)
        for unit in read_units(self._place, self._channel, instants):
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
        if instants.moved:
            self._fault(_moved(self._channel, instants))
