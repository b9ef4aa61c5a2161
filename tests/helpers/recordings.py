"""Recordings written on virtual time, for tests: messages, octets, and where each piece lies."""

from dataclasses import dataclass
from io import BytesIO

from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.records import Channel, Message, Metadata, Schema
from mcap.stream_reader import StreamReader, breakup_chunk

from kontur_av.sources.recorded_format import FORMAT, FORMAT_KEY
from pipelines.recording.mcap_stream import McapStream
from pipelines.recording.metadata import METADATA, RecordingMetadata
from pipelines.recording.recorded_messages import EVENT, VIDEO
from pipelines.recording.scan import FoundMessage, Scan
from pipelines.recording.schemas import descriptor_set

LIBRARY = "kontur-av test"
WALL_NS = 1_800_000_000_000_000_000
#: The shell that drives the stream looks this often.
POLL_NS = 50_000_000
METADATA_OF_A_TEST = RecordingMetadata(
    session="test",
    setup="spacejustin",
    setup_toml="name = 'spacejustin'\n",
    version="0.1.0",
    seed=1,
    command="kontur-av stream",
    part=1,
    session_ns=5,
    wall_ns=WALL_NS + 5,
)


def channel(number: int) -> tuple[Schema, Channel]:
    """A channel with its schema: pictures on even numbers, events on odd ones."""
    schema = (VIDEO, EVENT)[number % 2]
    return (
        Schema(
            id=1 + number % 2,
            name=schema.full_name,
            encoding="protobuf",
            data=descriptor_set(schema),
        ),
        Channel(
            id=number,
            topic=f"/channel/{number}",
            message_encoding="protobuf",
            schema_id=1 + number % 2,
            metadata={FORMAT_KEY: str(FORMAT)},
        ),
    )


@dataclass(frozen=True)
class Step:
    """After `wait_ns`, a message comes."""

    wait_ns: int
    channel: int
    late_ns: int
    data: bytes


@dataclass(frozen=True)
class Told:
    """A message: when it was handled, and what must come back of it."""

    now_ns: int
    channel: int
    sequence: int
    log_ns: int
    publish_ns: int
    data: bytes

    def read(self):
        """What a reader must find."""
        return (f"/channel/{self.channel}", self.sequence, self.log_ns, self.publish_ns, self.data)


@dataclass(frozen=True)
class Piece:
    """Octets `begin` to `end` of the file, and when the stream gave them."""

    begin: int
    end: int
    now_ns: int


@dataclass(frozen=True)
class Written:
    """A file. `pieces` are in its order, `told` in the order in which messages were handled."""

    octets: bytes
    pieces: list[Piece]
    told: list[Told]


steps = st.lists(
    st.builds(
        Step,
        wait_ns=st.integers(0, 700_000_000),
        channel=st.integers(0, 4),
        late_ns=st.integers(0, 300_000_000),
        data=st.binary(max_size=60) | st.builds(bytes, st.integers(0, 90_000)),
    ),
    max_size=25,
)


def write(script: list[Step], *, end: bool = True) -> Written:
    """Write a file; the stream is polled every 50 ms. end: with a summary."""
    stream = McapStream(library=LIBRARY)
    pieces: list[Piece] = []
    told: list[Told] = []
    octets = bytearray()
    now_ns = 0

    def fetch() -> None:
        while (piece := stream.poll_transmit(now_ns)) is not None:
            pieces.append(Piece(len(octets), len(octets) + len(piece), now_ns))
            octets.extend(piece)

    stream.handle_metadata(METADATA, METADATA_OF_A_TEST.items())
    for number in range(5):
        stream.handle_channel(*channel(number))
    fetch()
    for count, step in enumerate(script):
        arrival_ns = now_ns + step.wait_ns
        while now_ns + POLL_NS < arrival_ns:
            now_ns += POLL_NS
            fetch()
        now_ns = arrival_ns
        log_ns = WALL_NS + now_ns - step.late_ns
        message = Told(now_ns, step.channel, count, log_ns, WALL_NS + now_ns, step.data)
        told.append(message)
        assert stream.handle_message(
            step.channel,
            step.data,
            log_ns=message.log_ns,
            publish_ns=message.publish_ns,
            sequence=count,
            now_ns=now_ns,
        )
        fetch()
    if end:
        stream.handle_end()
        fetch()
    assert stream.octets == len(octets)
    return Written(bytes(octets), pieces, told)


def damaged(octets: bytes, flips: list[tuple[int, int]]) -> tuple[bytes, set[int]]:
    """The octets with these (place, mask) flipped, and the places that differ."""
    found = bytearray(octets)
    for place, mask in flips:
        found[place % len(found)] ^= mask
    return bytes(found), {at for at, octet in enumerate(octets) if octet != found[at]}


def sequences_in(written: Written, piece: Piece) -> set[int]:
    """The sequence numbers of the messages in a piece."""
    octets = written.octets[piece.begin : piece.end]
    if octets[:1] != bytes([Opcode.CHUNK]):
        return set()
    chunk = next(StreamReader(BytesIO(octets), skip_magic=True, emit_chunks=True).records)
    return {each.sequence for each in breakup_chunk(chunk) if isinstance(each, Message)}


def scanned(octets: bytes) -> tuple[Scan, list, list[Metadata]]:
    """A scan that is done, the messages that it found as `Told.read` has them, and metadata."""
    scan = Scan(memoryview(octets))
    messages, metadata = [], []
    for item in scan.items():
        if isinstance(item, FoundMessage):
            one = item.message
            at = (one.log_time, one.publish_time)
            messages.append((item.channel.topic, one.sequence, *at, one.data))
        elif isinstance(item, Metadata):
            metadata.append(item)
    return scan, messages, metadata
