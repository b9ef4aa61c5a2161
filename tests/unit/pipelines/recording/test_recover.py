"""A mended file is whole for any reader, and has all that could be read of the torn one."""

from io import BytesIO

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.records import Attachment, Channel, DataEnd, Footer, Metadata
from mcap.writer import Writer
from recordings import FACTS_OF_A_TEST, LIBRARY, Step, channel, scanned, steps, write

from kontur_av.errors import ProtocolError
from kontur_av.sources.recorded_format import FORMAT_KEY
from pipelines.recording.facts import FACTS, MENDED, RecordingFacts, sealed
from pipelines.recording.inventory import take_inventory
from pipelines.recording.mcap_stream import CHUNK_NS, MAGIC, McapStream, octets_of
from pipelines.recording.scan import FoundMessage, Recovery, Scan


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
    assert recovery.figures.sound == (torn == written.octets)
    mended = b"".join(recovery.pieces())

    scan, again, (facts, note) = scanned(mended)
    assert again == found
    assert scan.figures.sound
    assert RecordingFacts.of(facts.metadata) == FACTS_OF_A_TEST
    assert note.name == MENDED
    assert note.metadata["unread_octets"] == str(recovery.figures.unread_octets)
    assert Recovery(memoryview(mended)).figures.sound

    reader = make_reader(BytesIO(mended), validate_crcs=True)
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
    assert not scan.figures.holes and scan.figures.sound == (not torn)

    mended = b"".join(Recovery(memoryview(added)).pieces())
    reader = make_reader(BytesIO(mended), validate_crcs=True)
    assert [*reader.iter_attachments()] == [photo]
    assert note in reader.iter_metadata()


def test_channels_without_a_message_stay():
    written = write([])
    torn = written.octets[: written.pieces[-1].begin]
    mended = b"".join(Recovery(memoryview(torn)).pieces())
    assert len(make_reader(BytesIO(mended)).get_summary().channels) == 5


def test_a_file_of_another_program_is_not_mended():
    stream = BytesIO()
    writer = Writer(stream)
    writer.start(library="other 1.0")
    name = writer.register_channel("/a", "json", 0)
    writer.add_message(name, 1, b"{}", 1)
    writer.finish()
    with pytest.raises(ProtocolError, match=r"written by other 1\.0, not by kontur-av"):
        Recovery(memoryview(stream.getvalue()))


def newer(*, facts: bool) -> bytes:
    """A recording that says that it has format 2, in its facts or in its channel."""
    stream = McapStream(library=LIBRARY)
    if facts:
        stream.handle_metadata(FACTS, sealed(FACTS, {"format": "2"}))
    schema, row = channel(0)
    row.metadata = {FORMAT_KEY: "1" if facts else "2"}
    stream.handle_channel(schema, row)
    stream.handle_message(0, b"", log_ns=0, publish_ns=0, sequence=0, now_ns=0)
    stream.handle_end()
    return octets_until(stream, 0)


@pytest.mark.parametrize("facts", [True, False])
def test_a_newer_format_is_refused(facts):
    with pytest.raises(ProtocolError, match=r"it has format 2, .* reads up to format 1"):
        Recovery(memoryview(newer(facts=facts)))
    with pytest.raises(ProtocolError, match=r"install a newer one"):
        take_inventory(memoryview(newer(facts=facts)))


def test_another_recording_behind_the_first_is_not_mixed_in():
    scan, found, _ = scanned(begun("/1") + begun("/2"))
    assert [topic for topic, *_ in found] == ["/1"]
    assert not scan.figures.sound


def begun(topic: str) -> bytes:
    """A recording without an end, with one message on a channel that is always number 1."""
    stream = McapStream(library=LIBRARY)
    row = Channel(id=1, topic=topic, message_encoding="", schema_id=0, metadata={FORMAT_KEY: "1"})
    stream.handle_channel(None, row)
    stream.handle_message(1, b"", log_ns=0, publish_ns=0, sequence=0, now_ns=0)
    return octets_until(stream, CHUNK_NS)


def octets_until(stream: McapStream, now_ns: int) -> bytes:
    octets = b""
    while (piece := stream.poll_transmit(now_ns)) is not None:
        octets += piece
    return octets
