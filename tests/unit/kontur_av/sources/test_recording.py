"""Channels of recordings as sources, on virtual time: their times, gaps and faults."""

import tempfile
from fractions import Fraction
from itertools import pairwise
from pathlib import Path

import av
import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, IndexType, Writer

from kontur_av.clock import NS_PER_MS, NS_PER_S, ManualClock
from kontur_av.codecs.h26x import encoder_of
from kontur_av.codecs.opus import OpusEncoder
from kontur_av.errors import ConfigError
from kontur_av.media import CaptureStamp, VideoFrame, empty_picture, planes
from kontur_av.sources import check_spec, open_audio, open_video
from pipelines.recording.recorded_messages import RecordedPicture, RecordedSound, pack
from pipelines.recording.schemas import descriptor_set

WALL_NS = 1_800_000_000 * NS_PER_S
SIZE = (64, 48)
#: When each picture was captured: neither a fixed rate nor without a gap.
TIMES_MS = (0, 33, 70, 100, 20_100, 20_133)
LEVELS = (40, 60, 80, 100, 120, 140)


def units(levels=LEVELS, codec="h264"):
    encoder = encoder_of(codec)(width=SIZE[0], height=SIZE[1], fps=30, cap_bps=400_000)
    for level in levels:
        picture = empty_picture(*SIZE)
        planes(picture)[0][:] = level
        yield encoder.encode(VideoFrame(picture, CaptureStamp(0, 0, ""))).data


def packets(count):
    encoder = OpusEncoder(bitrate_bps=64_000)
    t = np.arange(960 * count) / 48_000
    tone = (np.sin(2 * np.pi * 440 * t) * 12_000).astype(np.int16)
    return [encoder.encode(tone[960 * k : 960 * (k + 1)]) for k in range(count)]


def write(path, channels):
    """Write {topic: [(ms, message)]} as any program would, with the plain `mcap` package."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        for topic, messages in channels.items():
            kind = type(messages[0][1]) if messages else RecordedPicture
            schema = writer.register_schema(
                kind.schema.full_name, "protobuf", descriptor_set(kind.schema)
            )
            channel = writer.register_channel(topic, "protobuf", schema)
            for ms, value in messages:
                instant_ns = WALL_NS + ms * NS_PER_MS
                writer.add_message(channel, instant_ns, pack(value), instant_ns)
        writer.finish()


def picture(data, format="h264"):
    return RecordedPicture(wall_ns=WALL_NS, frame_id="head", data=data, format=format)


def sound(data):
    return RecordedSound(wall_ns=WALL_NS, data=data)


def film(data, times=TIMES_MS, codec="h264"):
    return [(ms, picture(one, codec)) for ms, one in zip(times, data, strict=True)]


@pytest.fixture
def path(tmp_path):
    file = tmp_path / "a#b.mcap"
    spoken = [
        (20 * k, sound(data)) for k, data in enumerate(packets(50)) if k != 10 and not 20 <= k < 30
    ]
    channels = {"/head": film(units()), "/voice": spoken, "/empty": []}
    channels |= {"/h265": film(units(codec="h265"), codec="h265")}
    write(file, channels | {"/av1": [(0, picture(b"1", "av1"))]})
    return file


def opened(path, channel="/head", size=SIZE):
    """The source of a channel of pictures, and a picture for it."""
    width, height = size
    return open_video(
        f"mcap:{path}#{channel}", name="head", width=width, height=height, fps=30,
        clock=ManualClock(7),
    ), empty_picture(*size)  # fmt: skip


def seen_of(source, into, count):
    """(instant, mean luma) of so many pictures."""
    seen = []
    while len(seen) < count:
        if (stamp := source.read(into, NS_PER_S)) is not None:
            seen.append((stamp.capture_ns, planes(into)[0].mean()))
    return seen


@pytest.mark.parametrize("channel", ["/head", "/h265"])
def test_a_recorded_camera_keeps_its_intervals_and_loops(path, channel):
    source, into = opened(path, channel)
    seen = seen_of(source, into, 2 * len(TIMES_MS))
    steps = [b - a for (a, _), (b, _) in pairwise(seen)]
    wanted = [(b - a) * NS_PER_MS for a, b in pairwise(TIMES_MS)]
    assert steps == [*wanted, NS_PER_S // 30, *wanted]
    assert [level for _, level in seen] == pytest.approx(LEVELS * 2, abs=4)
    assert source.faults == 0
    # A coded size that was rounded fills the picture.
    source, into = opened(path, channel, (88, 64))
    source.read(into, NS_PER_S)
    assert planes(into)[0].min() > 30


def test_missing_sound_is_concealed_and_a_long_gap_is_silence(path):
    source = open_audio(f"mcap:{path}#/voice", name="mic", clock=ManualClock(0))
    blocks = []
    while len(blocks) < 100:
        frame = source.read(NS_PER_S)
        if frame is not None:
            blocks.append(frame.samples)
    loud = [bool(np.abs(block.astype(int)).max() > 6000) for block in blocks]
    # The missing block 10 is there, and the sound after the gap comes at its own time.
    assert all(loud[1:20])
    assert not any(np.any(block) for block in blocks[23:30])
    assert all(loud[31:50])
    assert loud[1:50] == loud[51:100]


@pytest.mark.parametrize(
    ("channel", "kind", "told"),
    [
        ("#/feet", "video", "no channel '/feet' with pictures; .* one of /av1, /empty, /h265"),
        ("#/voice", "video", "no channel '/voice' with pictures"),
        ("#/head", "audio", "one of /voice"),
        ("#/empty", "video", "channel /empty of .* is empty"),
        ("#/av1", "video", "is av1: take one with h264 or h265"),
    ],
)
def test_a_channel_that_cannot_be_played_is_refused(path, channel, kind, told):
    with pytest.raises(ConfigError, match=told):
        check_spec(f"mcap:{path}{channel}", kind)


@pytest.mark.parametrize(
    ("encoding", "schema", "words"),
    [
        ("jsonschema", b"{}", r"channel /head of .* in jsonschema, which is not read"),
        ("protobuf", b"\xff\xff", r"schema foxglove.CompressedVideo cannot be read"),
    ],
)
def test_a_schema_that_cannot_be_read_is_named(tmp_path, encoding, schema, words):
    with (tmp_path / "a.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        number = writer.register_schema("foxglove.CompressedVideo", encoding, schema)
        writer.add_message(writer.register_channel("/head", encoding, number), 1, b"{}", 1)
        writer.finish()
    with pytest.raises(ConfigError, match=words):
        check_spec(f"mcap:{tmp_path / 'a.mcap'}#/head", "video")


def test_pictures_that_are_no_annex_b_are_named(tmp_path):
    avcc = [data.replace(b"\0\0\0\1", b"\0\0\0\x20") for data in units()]
    write(tmp_path / "a.mcap", {"/head": film(avcc)})
    with pytest.raises(ConfigError, match=r"lengths before its NAL units \(AVCC\): .*Annex B"):
        check_spec(f"mcap:{tmp_path / 'a.mcap'}#/head", "video")


def test_b_pictures_are_told(tmp_path):
    coder = av.CodecContext.create("libx264", "w")
    coder.width, coder.height, coder.pix_fmt = *SIZE, "yuv420p"
    coder.time_base, coder.options = Fraction(1, 30), {"bf": "2", "b_strategy": "0"}
    frames = [av.VideoFrame.from_ndarray(empty_picture(*SIZE) + 9 * n, "yuv420p") for n in range(9)]
    for number, frame in enumerate(frames):
        frame.pts = number
    data = [bytes(packet) for frame in [*frames, None] for packet in coder.encode(frame)]
    write(tmp_path / "a.mcap", {"/head": film(data, range(0, 33 * len(data), 33))})
    source, into = opened(tmp_path / "a.mcap")
    for _ in range(30):
        source.read(into, NS_PER_S)
    assert "has B pictures, so its instants are wrong" in source.last_fault


def test_a_file_that_is_no_whole_recording_is_refused(tmp_path, path):
    torn, text = tmp_path / "torn.mcap", tmp_path / "text.mcap"
    torn.write_bytes(path.read_bytes()[:-300])
    text.write_bytes(b"not a recording at all, but long enough to have a footer of its own")
    for file, told in [
        (torn, "is no whole MCAP file .* `kontur-av recover` if it is torn"),
        (text, "is no whole MCAP file"),
        (tmp_path / "none.mcap", "no file"),
        (tmp_path, "is no file"),
    ]:
        with pytest.raises(ConfigError, match=told):
            check_spec(f"mcap:{file}#/head", "video")


def test_a_damaged_access_unit_costs_its_picture_and_is_counted(tmp_path):
    data = list(units())
    data[2] = b"\0\0\0\1\x65garbage"
    write(tmp_path / "a.mcap", {"/head": film(data)})
    source, into = opened(tmp_path / "a.mcap")
    seen = sum(source.read(into, NS_PER_S) is not None for _ in range(26))
    assert seen >= len(data) - 1
    assert source.faults >= 1
    assert "cannot be decoded" in source.last_fault


FLAGS = ("repeat_channels", "repeat_schemas", "use_chunking", "use_statistics")
FLAGS += ("use_summary_offsets", "enable_crcs", "enable_data_crcs")


@given(
    chunk_size=st.sampled_from([1, 2000, 1 << 20]),
    compression=st.sampled_from(list(CompressionType)),
    index_types=st.sampled_from([IndexType.ALL, IndexType.NONE, IndexType.CHUNK]),
    flags=st.fixed_dictionaries(dict.fromkeys(FLAGS, st.booleans())),
    reverse=st.booleans(),
)
@settings(max_examples=15, deadline=None)
def test_any_way_of_writing_a_file_plays(chunk_size, compression, index_types, flags, reverse):
    descriptors = FileDescriptorSet.FromString(descriptor_set(RecordedPicture.schema)).file
    schema_data = FileDescriptorSet(file=descriptors[:: -1 if reverse else 1]).SerializeToString()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "a#1.mcap")
        with path.open("wb") as file:
            writer = Writer(
                file,
                chunk_size=chunk_size,
                compression=compression,
                index_types=index_types,
                **flags,
            )
            writer.start()
            bare = writer.register_channel("/bare", "json", 0)
            schema = writer.register_schema("foxglove.CompressedVideo", "protobuf", schema_data)
            channel = writer.register_channel("/head #2", "protobuf", schema)
            for ms, data in zip(TIMES_MS[:4], units(LEVELS[:4]), strict=True):
                writer.add_message(bare, ms, b"{}", ms)
                instant_ns = WALL_NS + ms * NS_PER_MS
                writer.add_message(channel, instant_ns, pack(picture(data)), instant_ns)
            writer.finish()
        check_spec(f"mcap:{path}#/head #2", "video")
        source, into = opened(path, "/head #2")
        seen = [source.read(into, NS_PER_S // 50) for _ in range(7)]
    assert sum(stamp is not None for stamp in seen) == 4
    assert not source.faults


def test_instants_that_do_not_rise_are_moved_and_told(tmp_path):
    hour_ms = 3_600_000
    times = [0, 33, 66, *(at - hour_ms for at in (66, 99, 132))]
    write(tmp_path / "a.mcap", {"/head": film(units(), times)})
    source, into = opened(tmp_path / "a.mcap")
    steps = [b - a for (a, _), (b, _) in pairwise(seen_of(source, into, 7))]
    assert min(steps) >= NS_PER_MS and max(steps) < 70 * NS_PER_MS
    assert "instants were not after the one before" in source.last_fault
