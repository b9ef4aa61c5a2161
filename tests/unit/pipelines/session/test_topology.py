"""The table of a session is consistent."""

import inspect
from collections import Counter
from dataclasses import replace
from pkgutil import resolve_name

import pytest

from pipelines.hand.hand_topics import POLICY_TOPIC
from pipelines.recording.channels import sources_of
from pipelines.session.setup.segments import Segment
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.session.setup.table import PORTS, RtcLeg, Setup
from pipelines.session.topology.rows import Kind, VideoRow
from pipelines.session.topology.table import Topology
from pipelines.session.topology.topics import PAGES, TASKS
from pipelines.table import topology_of

WHOLE = BUILT_IN["spacejustin"]
SPACEJUSTIN = topology_of(WHOLE, snapshots=True, pages=True)


def every_setup() -> list[Setup]:
    """The built-in setups, one without each optional stream, a mediated hand, a partner's arm."""
    silent = {"uplink_voice": None, "downlink_video": None, "downlink_voice": None}
    changes = [
        *({name: None} for name in silent),
        {"cameras": ("static",)},
        {"hand": "mediated"},
        {"partner_arm": "shared"},
        {"partner_arm": "second"},
        {"rtc": RtcLeg()},
        {"rtc": RtcLeg(), **silent},
    ]
    return [*BUILT_IN.values(), *(replace(WHOLE, **each) for each in changes)]


SESSIONS = [(setup, False) for setup in every_setup()] + [(WHOLE, True)]


@pytest.fixture(
    params=SESSIONS, ids=[f"{len(each.streams)}-{each.cameras[0]}" for each, _ in SESSIONS]
)
def session(request) -> Topology:
    setup, tasks = request.param
    return topology_of(setup, snapshots=True, pages=True, tasks=tasks)


def test_names_ports_functions_streams_and_topics_of_a_session_agree(session):
    for rows in (session.processes, session.streams, session.topics, session.inputs):
        assert max(Counter(row.name for row in rows).values()) == 1
    ports = [port for row in session.processes for port in session.ports_of(row.name)]
    ports.append(session.launcher_port)
    assert max(Counter(ports).values()) == 1
    base = session.setup.base_port
    assert set(ports) <= set(range(base, base + PORTS))
    for row in session.processes:
        inspect.signature(resolve_name(row.run)).bind(None, **row.arguments)
    for row in session.streams:
        gateway = session.gateway(row.direction.sender)
        assert row.entry_port in session.ports_of(gateway.name)
        if row.kind is Kind.MAINTENANCE:
            assert row.sender is None and row.receiver is None
            continue
        sender, receiver = session.process(row.sender), session.process(row.receiver)
        assert sender.segment is row.direction.sender
        assert receiver.segment is row.direction.receiver
        assert row.exit_port in session.ports_of(receiver.name)
    crossing = set()
    for topic in session.topics:
        writer = session.process(topic.writer)
        assert topic.name in writer.writes
        readers = [row for row in session.processes if topic.name in session.reads(row.name)]
        assert list(topic.readers) == [row.name for row in readers]
        assert topic.name.sample
        if any(row.segment not in (None, writer.segment) for row in readers):
            crossing.add(topic.name)
    # A simulated cosmonaut looks at the task board and its LEDs.
    assert crossing <= {"robot/state", "mission/leds"}
    for row in session.processes:
        assert all(session.topic(name).name == name for name in session.reads(row.name))


def test_every_topic_that_is_read_has_a_writer_and_the_recorder_reads_only_what_is_here():
    sessions = [
        topology_of(setup, pages=True, recorder=True, trainer=True, tasks=True)
        for setup in every_setup()
    ]
    written = {row.name for session in sessions for row in session.topics}
    assert {name for one in sessions for row in one.processes for name in row.reads} <= {
        *written,
        POLICY_TOPIC,  # A user's program writes it.
    }

    def topics_of(**options):
        topology = topology_of(WHOLE, **options)
        return topology, {source.topic for source in sources_of(topology, link_frames=True)}

    for segment in Segment:
        here, topics = topics_of(recorder=True, segments=(segment,))
        assert topics
        assert all(here.runs(here.topic(topic).writer) for topic in topics)
    halves = [topics_of(segments=(segment,), pages=True)[1] for segment in Segment]
    assert topics_of(snapshots=True, pages=True)[1] == set.union(*halves)


def test_a_media_stream_leads_to_its_other_rows_and_consumers_start_before_producers(session):
    order = [row.name for row in session.processes]
    for row in session.media_streams:
        inputs = [session.input(name).process for name in row.inputs]
        starts = [order.index(name) for name in (row.display, row.receiver, row.sender)]
        assert starts == sorted(starts) and starts[-1] < min(map(order.index, inputs))
        assert row.stream in session.setup.streams
        rtcp = session.stream(row.rtcp)
        assert (rtcp.kind, rtcp.direction) == (Kind.RTCP, row.direction)
        if isinstance(row, VideoRow):
            feedback = session.stream(row.feedback)
            assert (feedback.kind, feedback.direction) == (Kind.FEEDBACK, row.direction.opposite)
            assert (feedback.sender, feedback.receiver) == (row.receiver, row.sender)
        assert session.topic(row.received_topic).readers[0] == row.display


def test_each_segment_can_be_started_alone_and_its_pages_read_only_what_it_has():
    assert set(PAGES.values()) <= {row.name for row in SPACEJUSTIN.processes}
    assert not set(PAGES.values()) & {row.name for row in topology_of(WHOLE).processes}
    for segment, name in PAGES.items():
        row = SPACEJUSTIN.process(name)
        assert row.segment is segment
        writers = {SPACEJUSTIN.topic(topic).writer for topic in SPACEJUSTIN.reads(name)}
        assert {SPACEJUSTIN.process(writer).segment for writer in writers} == {segment}
    # Every input is offered what a page of its segment gives.
    for row in SPACEJUSTIN.inputs:
        topic = SPACEJUSTIN.topic(row.page_topic)
        assert topic.writer == PAGES[SPACEJUSTIN.process(row.process).segment]
        assert topic.readers == (row.process,)
        assert row.page_topic in SPACEJUSTIN.reads(row.process)
        assert row.page_topic not in topology_of(WHOLE).reads(row.process)
    parts = [replace(SPACEJUSTIN, segments=(one,)).processes_here for one in Segment]
    names = [{row.name for row in rows} for rows in parts]
    assert names[0] & names[1] == {"snapshots"}
    assert names[0] | names[1] == {row.name for row in SPACEJUSTIN.processes}

    assert SPACEJUSTIN.shown_with("downlink_voice").name == "downlink_video"
    assert topology_of(replace(WHOLE, downlink_video=None)).shown_with("downlink_voice") is None
    with pytest.raises(KeyError):
        SPACEJUSTIN.media("telemetry")


@pytest.mark.parametrize("segment", Segment, ids=lambda segment: segment.value)
def test_one_end_holds_the_ports_and_processes_of_its_own_half(session, segment):
    tasks = any(row.name == TASKS for row in session.processes)
    mine, other = (
        topology_of(session.setup, snapshots=True, pages=True, tasks=tasks, segments=(each,))
        for each in (segment, segment.peer)
    )
    shared = {row.name for row in session.processes if row.segment is None}
    names = {row.name for row in mine.processes_here}
    assert names & {row.name for row in other.processes_here} == shared
    assert names == {row.name for row in session.processes if mine.runs(row.name)}
    held, others = set(mine.ports_here), set(other.ports_here)
    assert held & others == {mine.launcher_port}
    # Between two machines the radio has a port of its own.
    every = {port for row in session.processes for port in session.ports_of(row.name)}
    radio = {session.radio_port(each) for each in Segment}
    assert held | others == (every | {mine.launcher_port}) - radio
    assert (mine.alone, session.alone) == (segment, None)
    assert {mine.side_here(row) for row in mine.streams} == {"sender", "receiver"}
    assert {session.side_here(row) for row in session.streams} == {None}
