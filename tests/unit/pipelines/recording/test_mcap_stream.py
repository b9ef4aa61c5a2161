"""What the plain `mcap` package reads equals what was handled; chunks end by size and by time."""

from io import BytesIO

from hypothesis import given
from mcap.reader import NonSeekingReader, make_reader
from mcap.records import Chunk
from mcap.stream_reader import StreamReader
from recordings import LIBRARY, METADATA_OF_A_TEST, WALL_NS, channel, steps, write

from pipelines.recording.mcap_stream import CHUNK_NS, CHUNK_OCTETS, McapStream
from pipelines.recording.metadata import METADATA, RecordingMetadata, is_sealed


def read(messages):
    return [
        (channel.topic, message.sequence, message.log_time, message.publish_time, message.data)
        for _, channel, message in messages
    ]


@given(steps)
def test_the_plain_package_reads_what_was_written(script):
    written = write(script)
    told = [message.read() for message in written.told]
    linear = NonSeekingReader(BytesIO(written.octets), validate_crcs=True)
    assert read(linear.iter_messages(log_time_order=False)) == told

    reader = make_reader(BytesIO(written.octets), validate_crcs=True)
    indexed = read(reader.iter_messages())
    assert sorted(indexed) == sorted(told)
    assert [log_ns for _, _, log_ns, *_ in indexed] == sorted(log_ns for _, _, log_ns, *_ in told)

    assert reader.get_header().library == LIBRARY
    (metadata,) = reader.iter_metadata()
    assert metadata.name == METADATA
    assert is_sealed(metadata.name, metadata.metadata)
    assert RecordingMetadata.of(metadata.metadata) == METADATA_OF_A_TEST

    summary = reader.get_summary()
    assert {row.topic for row in summary.channels.values()} == {
        f"/channel/{number}" for number in range(5)
    }
    statistics = summary.statistics
    instants = [message.log_ns for message in written.told] or [0]
    assert statistics.message_count == len(told)
    assert statistics.message_start_time == min(instants)
    assert statistics.message_end_time == max(instants)
    assert statistics.chunk_count == len(summary.chunk_indexes)
    assert sum(statistics.channel_message_counts.values()) == len(told)


def started():
    stream = McapStream(library=LIBRARY)
    stream.handle_channel(*channel(0))
    assert stream.poll_transmit(0) is not None
    assert stream.poll_transmit(0) is None
    return stream


def say(stream, now_ns, data=b"1", number=0):
    return stream.handle_message(
        number, data, log_ns=WALL_NS, publish_ns=WALL_NS, sequence=0, now_ns=now_ns
    )


def test_a_chunk_ends_by_time_or_size_and_messages_are_refused_while_the_disk_lags():
    stream = started()
    assert stream.poll_timeout() is None
    say(stream, 100)
    say(stream, 200)
    assert stream.poll_timeout() == 100 + CHUNK_NS
    assert stream.poll_transmit(99 + CHUNK_NS) is None
    assert stream.poll_transmit(100 + CHUNK_NS) is not None
    assert stream.poll_timeout() is None
    stream = McapStream(library=LIBRARY)
    stream.handle_channel(*channel(0))
    for length in (CHUNK_OCTETS // 2, CHUNK_OCTETS // 2 + 1, CHUNK_OCTETS + 9, 5, 6):
        say(stream, 0, bytes(length))
    stream.handle_end()
    octets = b"".join(iter(lambda: stream.poll_transmit(0), None))
    records = StreamReader(BytesIO(octets), emit_chunks=True).records
    chunks = [record.uncompressed_size for record in records if isinstance(record, Chunk)]
    assert max(chunks) < CHUNK_OCTETS + 2000
    assert len([size for size in chunks if size > CHUNK_OCTETS]) == 1
    assert len(chunks) >= 3
    stream = McapStream(library=LIBRARY, most_waiting_octets=100)
    stream.handle_channel(*channel(0))
    assert say(stream, 0)
    # Nobody fetches: this ends the chunk, which then waits.
    assert say(stream, CHUNK_NS)
    assert stream.waiting_octets > 100
    assert not say(stream, CHUNK_NS + 1)
    while stream.poll_transmit(CHUNK_NS + 1) is not None:
        pass
    assert stream.waiting_octets == 0
    assert say(stream, CHUNK_NS + 2)
