"""What `kontur-av info` finds in a file: rates, gaps, missing messages, losses, damage."""

import pytest
from mcap.records import Message
from recordings import METADATA_OF_A_TEST, WALL_NS, Step, write

from pipelines.recording.channels import channels_of
from pipelines.recording.inventory import ChannelInventory, inventory_lines, take_inventory
from pipelines.recording.mcap_stream import McapStream
from pipelines.recording.metadata import METADATA
from pipelines.recording.recorded_messages import ChannelLoss, RecorderLosses, pack
from pipelines.recording.scan import Recovery
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.table import topology_of

SESSION = topology_of(BUILT_IN["taskboard"])
WRITTEN = write([Step(100_000_000, count % 2, 0, b"12345") for count in range(20)])


def message(sequence, log_ns=0):
    return Message(channel_id=0, log_time=log_ns, publish_time=0, data=b"123", sequence=sequence)


def test_a_channel_counts_what_is_missing_and_its_longest_gap():
    channel = ChannelInventory("/a", "b")
    for sequence, log_ns in ((5, 100), (6, 200), (9, 50), (10, 1200)):
        channel.handle_message(message(sequence, log_ns))
    assert (channel.messages, channel.octets, channel.missing) == (4, 12, 2)
    assert (channel.first_ns, channel.last_ns, channel.longest_gap_ns) == (50, 1200, 1000)
    # Its process was started again.
    channel.handle_message(message(0))
    channel.handle_message(message(2))
    assert channel.missing == 3
    # One that does not count misses nothing that is known.
    uncounted = ChannelInventory("/a", "b")
    for _ in range(3):
        uncounted.handle_message(message(0))
    assert (uncounted.missing, uncounted.rate_hz) == (None, 0.0)


def test_a_whole_recording():
    inventory = take_inventory(memoryview(WRITTEN.octets))
    assert inventory.metadata == METADATA_OF_A_TEST
    first, second, *empty = inventory.channels
    assert first.topic == "/channel/0"
    assert first.schema == "foxglove.CompressedVideo"
    assert (first.messages, second.messages) == (10, 10)
    assert first.rate_hz == pytest.approx(5.0)
    assert first.longest_gap_ns == 200_000_000
    assert [each.messages for each in empty] == [0, 0, 0]

    head, *_ = lines = inventory_lines(inventory, "a.mcap", 100)
    assert head.startswith("a.mcap: ")
    assert "20 messages on 5 channels" in head
    assert "session test of setup spacejustin, part 1" in lines[1]
    assert lines[3] == "1.9 s from 2027-01-15T08:00:00 UTC"
    assert lines[4] == ""


def state(octets):
    """The line about damage, if there is one."""
    return inventory_lines(take_inventory(memoryview(octets)), "a.mcap", 100)[4]


def test_torn_and_damaged_recordings_say_how_to_mend_them_and_losses_are_the_newest():
    octets = WRITTEN.octets
    assert state(octets[:-9]).startswith("torn or damaged: ")
    assert state(octets[:-9]).endswith("; `kontur-av recover a.mcap` fixes it")
    without_summary = octets[: WRITTEN.pieces[-2].begin]
    assert state(without_summary).startswith("torn: its summary is missing, all that was written")
    # The last octet of an index.
    index = bytearray(octets)
    index[WRITTEN.pieces[-3].end - 1] ^= 1
    assert state(bytes(index)).startswith("damaged, but every message can be read")
    repaired = b"".join(Recovery(memoryview(octets[:-9])).pieces())
    assert state(repaired).startswith("fixed: ")
    stream = McapStream(library="kontur-av")
    stream.handle_metadata(METADATA, METADATA_OF_A_TEST.items())
    (losses,) = (row for row in channels_of(SESSION) if row.topic == "/recorder/losses")
    stream.handle_channel(*losses.records())
    for dropped in (1, 5):
        lost = (ChannelLoss(channel="/a", missed=2, dropped=dropped),)
        data = pack(RecorderLosses(session_ns=0, losses=lost))
        instants = {"log_ns": WALL_NS, "publish_ns": WALL_NS, "now_ns": 0}
        stream.handle_message(losses.number, data, sequence=0, **instants)
    stream.handle_end()
    octets = b"".join(iter(lambda: stream.poll_transmit(0), None))
    assert state(octets) == "/a: the recorder missed 2 and dropped 5"
