"""Cut anywhere, a file gives back all but its last second, and nothing else than what it held."""

from io import BytesIO

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.records import Attachment, Channel, DataEnd, Footer, Metadata
from mcap.writer import CompressionType, Writer
from recordings import LIBRARY, METADATA_OF_A_TEST, WALL_NS, Step, scanned, steps, write

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ProtocolError
from kontur_av.sources.recorded_format import FORMAT_KEY
from pipelines.recording.inventory import take_inventory
from pipelines.recording.mcap_stream import CHUNK_NS, HEAD, MAGIC, McapStream, octets_of
from pipelines.recording.metadata import METADATA, REPAIRED, RecordingMetadata, sealed
from pipelines.recording.scan import FoundMessage, Recovery, Scan

#: Nine messages in chunks of two.
SCRIPT = [Step(200_000_000, count % 5, 0, bytes([count]) * 9) for count in range(9)]


@given(steps)
def test_a_whole_file_is_sound(script):
    written = write(script)
    scan, found, (metadata,) = scanned(written.octets)
    assert found == [message.read() for message in written.told]
    assert RecordingMetadata.of(metadata.metadata) == METADATA_OF_A_TEST
    assert scan.header.library == LIBRARY
    assert scan.ours
    assert scan.formats == {"1"}
    assert {row.topic for row in scan.channels.values()} == {f"/channel/{n}" for n in range(5)}
    assert scan.metrics.sound
    assert not scan.metrics.holes


@given(steps, st.floats(0, 1), st.binary(max_size=30), st.booleans())
def test_a_file_cut_anywhere_lacks_at_most_its_last_second(script, share, garbage, end):
    written = write(script, end=end)
    cut = round(share * len(written.octets))
    octets = written.octets[:cut] + garbage
    # As long as the file had so many octets: until this piece was written.
    until_ns = next(
        (piece.now_ns for piece in written.pieces if piece.end > cut), written.pieces[-1].now_ns
    )
    if octets[: len(MAGIC)] != MAGIC:
        with pytest.raises(ProtocolError):
            Scan(memoryview(octets))
        return
    scan, found, _ = scanned(octets)
    told = [message.read() for message in written.told]
    assert found == told[: len(found)]
    old = [message for message in written.told if message.now_ns <= until_ns - NS_PER_S]
    assert len(found) >= len(old)
    assert scan.metrics.sound == (octets == written.octets and end)


def test_a_cut_loses_its_chunk_alone_a_copy_is_whole_and_empty_channels_stay():
    written = write(SCRIPT, end=False)
    begin = written.pieces[-1].begin
    behind = begin + HEAD.unpack_from(written.octets, begin)[1] + HEAD.size
    for cut in (begin, begin + 1, behind - 1, behind, len(written.octets) - 1):
        scan, found, _ = scanned(written.octets[:cut])
        # Of the message indexes behind it, nothing is needed.
        assert len(found) == (6 if cut < behind else 8)
        assert cut >= behind or scan.metrics.holes == ([(begin, cut)] if cut > begin else [])
    _, told, (metadata,) = scanned(write(SCRIPT).octets)
    copied = other_program(told, metadata=(metadata.name, metadata.metadata), use_chunking=False)
    scan, found, _ = scanned(copied)
    assert found == told
    assert scan.ours and scan.metrics.sound
    scan, found, _ = scanned(b"".join(begun(channel_of(one), CHUNK_NS) for one in ("/1", "/2")))
    assert [topic for topic, *_ in found] == ["/1"]
    assert not scan.metrics.sound
    written = write([])
    torn = written.octets[: written.pieces[-1].begin]
    repaired = b"".join(Recovery(memoryview(torn)).pieces())
    assert len(make_reader(BytesIO(repaired)).get_summary().channels) == 5


def other_program(
    messages, *, library="other", metadata=("notes", {"by": "me"}), **options
) -> bytes:
    """A file of another program with these (topic, sequence, log_ns, publish_ns, data)."""
    stream = BytesIO()
    writer = Writer(stream, 100, **options)
    writer.start(profile="ros2", library=library)
    names = {}
    for topic, sequence, log_ns, publish_ns, data in messages:
        if topic not in names:
            schema = writer.register_schema(topic, "jsonschema", b"{}") if topic != "/2" else 0
            names[topic] = writer.register_channel(topic, "json", schema)
        writer.add_message(names[topic], log_ns, data, publish_ns, sequence)
    writer.add_metadata(*metadata)
    writer.finish()
    return stream.getvalue()


OTHERS = [(f"/{n % 3}", n, WALL_NS + n, WALL_NS, b"{}") for n in range(9)]


@pytest.mark.parametrize("compression", CompressionType)
@pytest.mark.parametrize("chunks", [True, False])
def test_a_file_of_another_program_is_read_but_not_mended(chunks, compression):
    octets = other_program(OTHERS, compression=compression, use_chunking=chunks)
    scan, found, (notes,) = scanned(octets)
    assert found == OTHERS
    assert notes.metadata == {"by": "me"}
    assert (scan.metrics.sound, scan.ours, scan.header.library) == (True, False, "other")
    with pytest.raises(ProtocolError, match=r"written by other, not by kontur-av"):
        Recovery(memoryview(octets))


@given(steps, st.floats(0.1, 1))
def test_a_mended_file_has_all_that_could_be_read(script, share):
    written = write(script)
    torn = written.octets[: round(share * len(written.octets))]
    _, found, metadata = scanned(torn)
    if not found and not metadata:
        with pytest.raises(ProtocolError, match="nothing in it can be read"):
            Recovery(memoryview(torn))
        return
    recovery = Recovery(memoryview(torn))
    assert recovery.metrics.sound == (torn == written.octets)
    repaired = b"".join(recovery.pieces())

    scan, again, (metadata, note) = scanned(repaired)
    assert again == found
    assert scan.metrics.sound
    assert RecordingMetadata.of(metadata.metadata) == METADATA_OF_A_TEST
    assert note.name == REPAIRED
    assert note.metadata["unread_octets"] == str(recovery.metrics.unread_octets)
    assert Recovery(memoryview(repaired)).metrics.sound

    reader = make_reader(BytesIO(repaired), validate_crcs=True)
    read = [(channel.topic, message.data) for _, channel, message in reader.iter_messages()]
    assert sorted(read) == sorted((topic, data) for topic, *_, data in found)


@given(st.data(), st.booleans(), st.booleans())
def test_what_a_user_has_added_is_whole_and_stays(data, checked, torn):
    """Metadata and attachments, as `mcap add` writes them, with a check or without."""
    written = write([Step(300_000_000, count % 2, 0, b"1234") for count in range(9)])
    note = Metadata(name="notes", metadata={"by": "me"})
    photo = Attachment(name="a.jpg", media_type="image/jpeg", create_time=1, log_time=2, data=b"x")
    attached = octets_of(photo) if checked else octets_of(photo)[:-4] + bytes(4)
    ends = [piece.end for piece in written.pieces[1:-2]]
    places = data.draw(st.permutations(ends))[:2]
    added, at = b"", 0
    for place, octets in sorted(zip(places, (octets_of(note), attached), strict=True)):
        added, at = added + written.octets[at:place] + octets, place
    # An end without a summary, as after `mcap add` by a program that writes no checks.
    if not torn:
        end = [DataEnd(data_section_crc=0)]
        end.append(Footer(summary_start=0, summary_offset_start=0, summary_crc=0))
        rest = written.octets[at : written.pieces[-2].begin]
        added += rest + b"".join(octets_of(one) for one in end) + MAGIC
    scan = Scan(memoryview(added))
    found = [item for item in scan.items() if not isinstance(item, FoundMessage)][1:]
    assert note in found and photo in found
    assert not scan.metrics.holes and scan.metrics.sound == (not torn)

    repaired = b"".join(Recovery(memoryview(added)).pieces())
    reader = make_reader(BytesIO(repaired), validate_crcs=True)
    assert [*reader.iter_attachments()] == [photo]
    assert note in reader.iter_metadata()


def begun(row, until_ns=0, metadata=None) -> bytes:
    """A recording with one message on this channel, ended or left open."""
    stream, octets = McapStream(library=LIBRARY), b""
    if metadata:
        stream.handle_metadata(METADATA, sealed(METADATA, metadata))
    stream.handle_channel(None, row)
    stream.handle_message(row.id, b"", log_ns=0, publish_ns=0, sequence=0, now_ns=0)
    if not until_ns:
        stream.handle_end()
    while (piece := stream.poll_transmit(until_ns)) is not None:
        octets += piece
    return octets


def channel_of(topic, version="1"):
    metadata = {FORMAT_KEY: version}
    return Channel(id=1, topic=topic, message_encoding="", schema_id=0, metadata=metadata)


@pytest.mark.rule("7")
@pytest.mark.parametrize(("version", "metadata"), [("1", {"format": "2"}), ("2", None)])
def test_a_newer_format_is_refused(version, metadata):
    newer = memoryview(begun(channel_of("/1", version), metadata=metadata))
    with pytest.raises(ProtocolError, match=r"it has format 2, .* reads up to format 1"):
        Recovery(newer)
    with pytest.raises(ProtocolError, match=r"install a newer one"):
        take_inventory(newer)
