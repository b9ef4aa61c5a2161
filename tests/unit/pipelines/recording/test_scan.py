"""Cut anywhere, a file gives back all but its last second, and nothing else than what it held."""

from io import BytesIO

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.writer import CompressionType, Writer
from recordings import FACTS_OF_A_TEST, LIBRARY, WALL_NS, Step, scanned, sequences_in, steps, write

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ProtocolError
from pipelines.recording.facts import RecordingFacts
from pipelines.recording.mcap_stream import HEAD, MAGIC
from pipelines.recording.scan import Scan

#: Nine messages in chunks of two.
SCRIPT = [Step(200_000_000, count % 5, 0, bytes([count]) * 9) for count in range(9)]


@given(steps)
def test_a_whole_file_is_sound(script):
    written = write(script)
    scan, found, (facts,) = scanned(written.octets)
    assert found == [message.read() for message in written.told]
    assert RecordingFacts.of(facts.metadata) == FACTS_OF_A_TEST
    assert scan.header.library == LIBRARY
    assert scan.ours
    assert scan.formats == {"1"}
    assert {row.topic for row in scan.channels.values()} == {f"/channel/{n}" for n in range(5)}
    assert scan.figures.sound
    assert not scan.figures.holes


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
    assert scan.figures.sound == (octets == written.octets and end)


def test_a_cut_at_every_octet_of_the_last_chunk_loses_this_chunk_alone():
    written = write(SCRIPT, end=False)
    begin = written.pieces[-1].begin
    _, kept, _ = scanned(written.octets[:begin])
    assert len(kept) == 6
    for cut in range(begin, len(written.octets)):
        scan, found, _ = scanned(written.octets[:cut])
        chunk = HEAD.unpack_from(written.octets, begin)[1] + HEAD.size
        if cut < begin + chunk:
            assert found == kept
            assert scan.figures.holes == ([(begin, cut)] if cut > begin else [])
        else:
            # Of the message indexes behind it, nothing is needed.
            assert len(found) > len(kept)


def test_a_damaged_chunk_costs_no_other_even_if_it_is_the_first():
    written = write(SCRIPT)
    chunks = [piece for piece in written.pieces if written.octets[piece.begin] == Opcode.CHUNK]
    for piece in chunks:
        for place in (piece.begin, piece.begin + 3, piece.begin + 33):
            octets = bytearray(written.octets)
            octets[place] ^= 0x40
            scan, found, _ = scanned(bytes(octets))
            lost = sequences_in(written, piece)
            assert lost
            assert [row[1] for row in found] == [n for n in range(9) if n not in lost]
            assert not scan.figures.sound
            assert scan.figures.unread_octets > 0


def test_an_index_that_becomes_a_message_is_none():
    written = write(SCRIPT)
    piece = next(piece for piece in written.pieces if written.octets[piece.begin] == Opcode.CHUNK)
    index = piece.begin + HEAD.size + HEAD.unpack_from(written.octets, piece.begin)[1]
    assert written.octets[index] == Opcode.MESSAGE_INDEX
    for opcode in range(256):
        octets = bytearray(written.octets)
        octets[index] = opcode
        scan, found, _ = scanned(bytes(octets))
        assert len(found) == len(SCRIPT)
        assert scan.figures.sound == (opcode == Opcode.MESSAGE_INDEX)


def other_program(*, chunks: bool, compression: CompressionType) -> bytes:
    stream = BytesIO()
    writer = Writer(stream, 100, compression, use_chunking=chunks)
    writer.start(profile="ros2", library="other")
    schema = writer.register_schema("a", "jsonschema", b"{}")
    names = [writer.register_channel(f"/{n}", "json", schema) for n in range(2)]
    names.append(writer.register_channel("/2", "json", 0))
    for count in range(9):
        writer.add_message(names[count % 3], WALL_NS + count, b"{}", WALL_NS, count)
    writer.add_metadata("notes", {"by": "me"})
    writer.add_attachment(1, 2, "a.txt", "text/plain", b"text")
    writer.finish()
    return stream.getvalue()


@pytest.mark.parametrize("compression", CompressionType)
@pytest.mark.parametrize("chunks", [True, False])
def test_a_file_of_another_program_is_read(chunks, compression):
    octets = other_program(chunks=chunks, compression=compression)
    scan, found, (notes,) = scanned(octets)
    assert [(topic, sequence) for topic, sequence, *_ in found] == [
        (f"/{count % 3}", count) for count in range(9)
    ]
    assert notes.metadata == {"by": "me"}
    assert scan.figures.sound
    assert scan.header.library == "other"
    assert not scan.ours
    assert len(scan.channels) == 3


def test_our_recording_is_whole_when_another_program_has_copied_it_without_chunks():
    _, told, (facts,) = scanned(write(SCRIPT).octets)
    stream = BytesIO()
    writer = Writer(stream, use_chunking=False)
    writer.start(library="other")
    writer.add_metadata(facts.name, facts.metadata)
    names = {}
    for topic, sequence, log_ns, publish_ns, data in told:
        if topic not in names:
            names[topic] = writer.register_channel(topic, "protobuf", 0)
        writer.add_message(names[topic], log_ns, data, publish_ns, sequence)
    writer.finish()
    scan, found, _ = scanned(stream.getvalue())
    assert found == told
    assert scan.ours
    assert scan.figures.sound


def test_an_attachment_without_a_check_is_passed_over_in_a_file_of_another_program():
    octets = other_program(chunks=True, compression=CompressionType.ZSTD)
    text = octets.index(b"text", octets.index(b"a.txt") + 20)
    without = octets[: text + 4] + bytes(4) + octets[text + 8 :]
    assert without != octets
    scan, found, _ = scanned(without)
    assert len(found) == 9
    assert scan.figures.sound


def test_octets_that_are_no_mcap_file_are_refused():
    for octets in (b"", MAGIC[:-1], b"RIFF" + bytes(40), b"\x89MCAP1\r\n" + bytes(40)):
        with pytest.raises(ProtocolError, match="not an MCAP file"):
            Scan(memoryview(octets))
