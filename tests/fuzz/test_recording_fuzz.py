"""Damage anywhere in a recording raises nothing, and costs no more than the chunks that it hits."""

from functools import lru_cache

from hypothesis import example, given
from hypothesis import strategies as st
from recordings import METADATA_OF_A_TEST, Step, damaged, scanned, sequences_in, steps, write

from pipelines.recording.mcap_stream import MAGIC
from pipelines.recording.metadata import METADATA, RecordingMetadata

flips = st.lists(st.tuples(st.integers(0, 1 << 20), st.integers(1, 255)), max_size=4)


@lru_cache(1)
def small():
    """Seven chunks, each with messages of two channels."""
    return write([Step(210_000_000, count % 5, 0, bytes([count]) * 12) for count in range(14)])


def check(written, octets, hit):
    """hit: places of the file as it was that are not as they were."""
    scan, found, metadata = scanned(octets)
    told = [message.read() for message in written.told]
    lost = set()
    for piece in written.pieces:
        if any(piece.begin <= place < piece.end for place in hit):
            lost |= sequences_in(written, piece)
    kept = {sequence for _, sequence, *_ in found}
    assert found == [message for message in told if message[1] in kept]
    assert kept >= {sequence for _, sequence, *_ in told} - lost
    assert all(RecordingMetadata.of(row.metadata) == METADATA_OF_A_TEST for row in metadata)
    if octets != written.octets:
        assert not scan.metrics.sound


@given(flips)
@example([(9, 1)])
# The length of a metadata record grows.
@example([(40, 2)])
def test_flipped_octets_of_a_small_file(flipped):
    octets, hit = damaged(small().octets, flipped)
    if octets.startswith(MAGIC):
        check(small(), octets, hit)


@given(steps, flips)
def test_flipped_octets(script, flipped):
    written = write(script)
    octets, hit = damaged(written.octets, flipped)
    if octets.startswith(MAGIC):
        check(written, octets, hit)


@given(
    st.integers(len(MAGIC), len(small().octets)),
    st.integers(0, 2000),
    st.binary(max_size=40),
)
def test_octets_cut_out_or_put_in(at, length, inserted):
    octets = small().octets
    check(small(), octets[:at] + inserted + octets[at + length :], range(at - 1, at + length + 1))


@given(st.binary(max_size=300) | st.lists(st.sampled_from(range(16)), max_size=300).map(bytes))
def test_any_octets(octets):
    scan, found, metadata = scanned(MAGIC + octets)
    assert not scan.ours
    assert not any(row.name == METADATA for row in metadata)
    assert scan.metrics.messages == len(found)
    assert scan.metrics.octets == len(octets) + len(MAGIC)
