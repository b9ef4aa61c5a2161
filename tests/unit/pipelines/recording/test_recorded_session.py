"""A recording as what was sent in it, without what the recorder has added."""

from dataclasses import replace

import pytest
from synthetic_recording import METADATA_OF_SYNTHETIC, octets_of_part, wall_ns, write_recording

from kontur_av.errors import ProtocolError
from pipelines.recording.channels import channels_of
from pipelines.recording.joined import JoinedRecording, read_part
from pipelines.recording.recorded_messages import (
    NO_SAMPLE,
    RecordedPicture,
    UnitMetadata,
    pack,
    unpack,
)
from pipelines.recording.recorded_session import read_session
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.table import topology_of

ROWS = channels_of(topology_of(BUILT_IN["spacejustin"]))


def session_of(*parts):
    return read_session(JoinedRecording(parts=[read_part(octets) for octets in parts]))


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    return write_recording(tmp_path_factory.mktemp("recording") / "a.mcap")


def test_all_that_was_sent_comes_back_and_a_beginning_has_what_was_sent_until_then(written):
    session = session_of(memoryview(written.paths[0].read_bytes()))
    assert session.metadata == METADATA_OF_SYNTHETIC
    for name in ("uplink_video", "downlink_video"):
        coded = [(unit.capture_ns, unit.data, unit.key, "h264") for unit in written.units[name]]
        assert session.pictures[name] == coded
    assert len(session.received["uplink_video"]) == len(session.pictures["uplink_video"]) - 1
    assert len(session.voices["uplink_voice"]) == len(written.told["/uplink_voice/sent"])
    for key in ("up", "down"):
        assert (session.haptics[key] == written.haptics[f"/haptic/{key}/sent"]).all()
    assert [packet.sent_ns for packet in session.packets["telecommand"]] == [
        told.log_ns for told in written.told["/telecommand/space/sent"]
    ]
    assert session.instants_ns[0] == METADATA_OF_SYNTHETIC.session_ns
    assert "/uplink_video/sent" not in session.missing
    begin = session.begin(1.0)
    first_ns = session.instants_ns[0]
    assert begin.instants_ns[0] == first_ns
    assert 0.95e9 < begin.instants_ns[1] - first_ns < 1e9
    units = begin.pictures["uplink_video"]
    assert units == session.pictures["uplink_video"][: len(units)] and len(units) > 10
    assert len(begin.voices["uplink_voice"]) == 50
    assert len(begin.haptics["up"]) == 1000
    # The telecommand comes later.
    assert "telecommand" in session.packets and "telecommand" not in begin.packets


def part_of(told):
    return memoryview(octets_of_part(ROWS, METADATA_OF_SYNTHETIC, told, True))


def test_what_the_recorder_put_ahead_of_a_part_is_left_out(written):
    """A key picture of its own, and parameter sets in front of the first unit."""
    units, metadata = (
        list(written.told[topic][5:])
        for topic in ("/uplink_video/sent", "/uplink_video/sent/facts")
    )
    value = unpack(RecordedPicture, units[0].data)
    units[0] = replace(units[0], data=pack(replace(value, data=b"\0\0\0\1\x67SPS" + value.data)))
    ahead_ns = units[0].log_ns - 1000
    key = RecordedPicture(wall_ns=wall_ns(ahead_ns), frame_id="", data=b"\0\0\0\1\x65added")
    fact = replace(unpack(UnitMetadata, metadata[0].data), added=True, octets=len(key.data))
    told = [
        replace(units[0], log_ns=ahead_ns, data=pack(key)),
        replace(metadata[0], log_ns=ahead_ns, data=pack(fact)),
        *units,
        *metadata,
    ]
    session = session_of(part_of(told))
    assert [unit.data for unit in session.pictures["uplink_video"]] == [
        unit.data for unit in written.units["uplink_video"][5:]
    ]


def test_cycles_without_a_sample_are_gaps_and_packets_are_also_read_by_older_names(written):
    told = list(written.told["/haptic/up/received"])
    as_sent = [replace(one, topic="/haptic/up/sent") for one in told if one.sequence != 7]
    session = session_of(part_of(as_sent))
    assert (session.haptics["up"]["sequence"] != NO_SAMPLE).all()
    assert session.missing == {"/haptic/up/sent": 1}
    with pytest.raises(ProtocolError, match="nothing that was sent is in it"):
        session_of(part_of(written.told["/events"]))
    (command,) = written.told["/telecommand/space/sent"]
    report = replace(command, topic="/telemetry/space/sent", log_ns=command.log_ns - 1000)
    old = "/telecommand/sent"
    rows = [replace(row, topic=old) if row.topic == command.topic else row for row in ROWS]
    told = [replace(one, topic=old) for one in (report, command)]
    older = session_of(memoryview(octets_of_part(rows, METADATA_OF_SYNTHETIC, told, True)))
    newer = session_of(part_of([report, command]))
    assert newer.packets == older.packets
    assert len(newer.packets["telecommand"]) == 2
    assert [one.sent_ns for one in newer.packets["telecommand"]] == [command.log_ns] * 2
