"""The table of a session is consistent, and its ports are the documented ones."""

import inspect
from collections import Counter
from dataclasses import replace
from pkgutil import resolve_name

import pytest

from pipelines.recording.channels import sources_of
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.session.setup.table import PORTS, RtcLeg, Setup
from pipelines.session.topology import PAGES, TASKS, Direction, Kind, Segment, Topology, VideoRow
from pipelines.table import topology_of

SPACEJUSTIN = topology_of(BUILT_IN["spacejustin"], snapshots=True, pages=True)


def every_setup() -> list[Setup]:
    """The built-in setups, one without each optional stream, a mediated hand, a partner's arm."""
    whole = BUILT_IN["spacejustin"]
    return [
        *BUILT_IN.values(),
        replace(whole, uplink_voice=None),
        replace(whole, downlink_video=None),
        replace(whole, downlink_voice=None),
        replace(whole, cameras=("static",)),
        replace(whole, hand="mediated"),
        replace(whole, partner_arm="shared"),
        replace(whole, partner_arm="second"),
        replace(whole, rtc=RtcLeg()),
        replace(whole, rtc=RtcLeg(), uplink_voice=None, downlink_video=None, downlink_voice=None),
    ]


SESSIONS = [(setup, False) for setup in every_setup()] + [(BUILT_IN["spacejustin"], True)]


@pytest.fixture(
    params=SESSIONS, ids=[f"{len(each.streams)}-{each.cameras[0]}" for each, _ in SESSIONS]
)
def session(request) -> Topology:
    setup, tasks = request.param
    return topology_of(setup, snapshots=True, pages=True, tasks=tasks)


def test_names_are_unique(session):
    for rows in (session.processes, session.streams, session.topics, session.inputs):
        assert max(Counter(row.name for row in rows).values()) == 1


def test_every_topic_that_is_read_has_a_writer_in_some_session():
    sessions = [
        topology_of(setup, pages=True, recorder=True, trainer=True, tasks=True)
        for setup in every_setup()
    ]
    written = {row.name for session in sessions for row in session.topics}
    assert {name for one in sessions for row in one.processes for name in row.reads} <= written


def test_a_topic_has_the_readers_that_read_it(session):
    for topic in session.topics:
        assert topic.name in session.process(topic.writer).writes
        readers = [row.name for row in session.processes if topic.name in session.reads(row.name)]
        assert list(topic.readers) == readers
        assert topic.name.sample
    for row in session.processes:
        assert all(session.topic(name).name == name for name in session.reads(row.name))


def test_only_the_simulated_world_is_read_in_both_segments(session):
    crossing = {
        topic.name
        for topic in session.topics
        for reader in topic.readers
        if session.process(reader).segment not in (None, session.process(topic.writer).segment)
    }
    # A simulated cosmonaut looks at the task board and its LEDs.
    assert crossing <= {"robot/state", "mission/leds"}


def test_every_port_is_unique_and_within_the_session(session):
    ports = [port for row in session.processes for port in session.ports_of(row.name)]
    ports.append(session.launcher_port)
    assert max(Counter(ports).values()) == 1
    base = session.setup.base_port
    assert set(ports) <= set(range(base, base + PORTS))


def test_every_stream_runs_from_a_sender_to_a_receiver_in_the_other_segment(session):
    for row in session.streams:
        gateway = session.gateway(row.direction.sender)
        assert row.entry_port in session.ports_of(gateway.name)
        if row.kind is Kind.MAINTENANCE:
            assert row.sender is None and row.receiver is None
            continue
        sender, receiver = session.process(row.sender), session.process(row.receiver)
        assert sender.segment is row.direction.sender and row.name in session.sends(sender.name)
        assert receiver.segment is row.direction.receiver
        assert row.name in session.receives(receiver.name)
        assert row.exit_port in session.ports_of(receiver.name)


def test_every_function_exists_and_takes_its_arguments(session):
    for row in session.processes:
        signature = inspect.signature(resolve_name(row.run))
        signature.bind(None, **row.arguments)


def test_consumers_start_before_producers(session):
    order = [row.name for row in session.processes]
    for row in session.media_streams:
        assert order.index(row.display) < order.index(row.receiver) < order.index(row.sender)
        for name in row.inputs:
            assert order.index(row.sender) < order.index(session.input(name).process)


def test_a_media_stream_leads_to_its_other_rows(session):
    for row in session.media_streams:
        assert row.stream in session.setup.streams
        rtcp = session.stream(row.rtcp)
        assert (rtcp.kind, rtcp.direction) == (Kind.RTCP, row.direction)
        if isinstance(row, VideoRow):
            feedback = session.stream(row.feedback)
            assert (feedback.kind, feedback.direction) == (Kind.FEEDBACK, row.direction.opposite)
            assert (feedback.sender, feedback.receiver) == (row.receiver, row.sender)
        assert session.topic(row.received_topic).readers[0] == row.display


def test_the_ports_are_the_documented_ones():
    known = {
        "uplink_haptic": (27002, 27005),
        "telemetry": (27030, 27031),
        "uplink_voice": (27014, 27016),
        "uplink_voice_rtcp": (27015, 27017),
        "uplink_video": (27010, 27012),
        "uplink_video_rtcp": (27011, 27013),
        "feedback_downlink_video": (27028, 27029),
        "uplink_maintenance": (27034, 27036),
        "downlink_haptic": (27004, 27003),
        "telecommand": (27032, 27033),
        "downlink_voice": (27022, 27024),
        "downlink_voice_rtcp": (27023, 27025),
        "downlink_video": (27018, 27020),
        "downlink_video_rtcp": (27019, 27021),
        "feedback_uplink_video": (27026, 27027),
        "downlink_maintenance": (27037, 27039),
    }
    # The order is that of priority, and of the flows' numbers on the link.
    found = {row.name: (row.entry_port, row.exit_port) for row in SPACEJUSTIN.streams}
    assert list(found.items()) == list(known.items())
    assert [link.port for link in SPACEJUSTIN.links] == [27001, 27000]
    assert SPACEJUSTIN.launcher_port == 27006


def test_lookups_find_what_belongs_together():
    assert SPACEJUSTIN.media("uplink_video").sender == "uplink_video_send"
    assert SPACEJUSTIN.media("downlink_voice").receiver == "downlink_voice_receive"
    assert SPACEJUSTIN.gateway(Segment.SPACE).name == "space_gateway"
    assert SPACEJUSTIN.input("head").process == "camera_head"
    assert SPACEJUSTIN.input("iss_camera").process == "iss_camera"
    assert SPACEJUSTIN.camera("stereo").inputs == ("left", "right")
    assert SPACEJUSTIN.haptic("up").direction is Direction.UPLINK
    picture = SPACEJUSTIN.shown_with("downlink_voice")
    assert picture is not None and picture.name == "downlink_video"
    without = topology_of(replace(SPACEJUSTIN.setup, downlink_video=None))
    assert without.shown_with("downlink_voice") is None
    with pytest.raises(KeyError):
        SPACEJUSTIN.media("telemetry")


def test_each_segment_can_be_started_alone():
    parts = [replace(SPACEJUSTIN, segments=(one,)).processes_here for one in Segment]
    names = [{row.name for row in rows} for rows in parts]
    assert names[0] & names[1] == {"snapshots"}
    assert names[0] | names[1] == {row.name for row in SPACEJUSTIN.processes}


def test_pages_are_asked_for_and_read_only_what_their_segment_has():
    setup = SPACEJUSTIN.setup
    assert set(PAGES.values()) <= {row.name for row in SPACEJUSTIN.processes}
    assert not set(PAGES.values()) & {row.name for row in topology_of(setup).processes}
    for segment, name in PAGES.items():
        row = SPACEJUSTIN.process(name)
        assert row.segment is segment
        writers = {SPACEJUSTIN.topic(topic).writer for topic in SPACEJUSTIN.reads(name)}
        assert {SPACEJUSTIN.process(writer).segment for writer in writers} == {segment}


def test_every_input_is_offered_what_a_page_of_its_segment_gives():
    for row in SPACEJUSTIN.inputs:
        process = SPACEJUSTIN.process(row.process)
        topic = SPACEJUSTIN.topic(row.page_topic)
        assert topic.writer == PAGES[process.segment]
        assert topic.readers == (row.process,)
        assert row.page_topic in SPACEJUSTIN.reads(row.process)
        assert row.page_topic not in topology_of(SPACEJUSTIN.setup).reads(row.process)


@pytest.mark.parametrize("segment", Segment, ids=lambda segment: segment.value)
def test_one_end_holds_the_ports_and_processes_of_its_own_half(session, segment):
    tasks = any(row.name == TASKS for row in session.processes)
    ends = {
        each: topology_of(session.setup, snapshots=True, pages=True, tasks=tasks, segments=(each,))
        for each in Segment
    }
    mine, other = ends[segment], ends[segment.peer]
    shared = {row.name for row in session.processes if row.segment is None}
    names = {row.name for row in mine.processes_here}
    assert names & {row.name for row in other.processes_here} == shared
    assert names == {row.name for row in session.processes if mine.runs(row.name)}
    held = set(mine.ports_here) - {mine.launcher_port}
    assert held & set(other.ports_here) == set()
    # Between two machines the radio has a port of its own.
    radio = {session.radio_port(each) for each in Segment}
    assert (
        held | set(other.ports_here)
        == {
            mine.launcher_port,
            *(port for row in session.processes for port in session.ports_of(row.name)),
        }
        - radio
    )
    assert (mine.alone, session.alone) == (segment, None)
    assert {mine.side_here(row) for row in mine.streams} == {"sender", "receiver"}
    assert {session.side_here(row) for row in session.streams} == {None}


def test_the_recorder_and_the_snapshots_read_only_what_is_here():
    for segment in Segment:
        here = topology_of(BUILT_IN["spacejustin"], recorder=True, segments=(segment,))
        topics = {source.topic for source in sources_of(here, link_frames=True)}
        assert topics
        assert all(here.runs(here.topic(topic).writer) for topic in topics)
    every = {source.topic for source in sources_of(SPACEJUSTIN, link_frames=True)}
    halves = [topology_of(BUILT_IN["spacejustin"], segments=(segment,)) for segment in Segment]
    assert every == {s.topic for half in halves for s in sources_of(half, link_frames=True)}
