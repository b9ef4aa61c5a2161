"""The table of a replay: nothing is captured, and every script is joined to its topics."""

import pytest

from pipelines.recording.rows import Script, replay_topology
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.table import topology_of

SESSION = topology_of(BUILT_IN["spacejustin"], snapshots=True)
SCRIPT = Script("somewhere:run", {"units": []})
PICTURES = ("uplink_video", "downlink_video")
CAPTURES = {row.process for row in SESSION.inputs}


@pytest.fixture(params=[(), PICTURES], ids=["as-recorded", "recoded"])
def recoded(request):
    return request.param


@pytest.fixture
def table(recoded):
    senders = {row.sender for row in SESSION.media_streams if row.name not in recoded}
    scripts = dict.fromkeys(senders | {"robot", "joystick", "console", "selector"}, SCRIPT)
    return replay_topology(
        SESSION, scripts, dict.fromkeys(recoded, SCRIPT), radio_after_ns=2_000_000
    )


def test_every_topic_has_a_writer_and_the_readers_that_read_it(table):
    for topic in table.topics:
        assert topic.name in table.process(topic.writer).writes
        readers = [row.name for row in table.processes if topic.name in table.reads(row.name)]
        assert list(topic.readers) == readers
    # The ports and the streams of the link are those of the session.
    assert table.streams == SESSION.streams
    for row in table.processes:
        assert table.ports_of(row.name) == SESSION.ports_of(row.name)
    for link in table.links:
        gateway, before = table.process(link.sender), SESSION.process(link.sender)
        assert gateway.run == before.run
        assert gateway.arguments == {**before.arguments, "radio_after_ns": 2_000_000}


def test_scripts_replace_what_sends_and_recoded_pictures_are_coded_by_the_streams_own_sender(
    table, recoded
):
    cameras = {row.name for row in table.processes} & CAPTURES
    kept = (
        {SESSION.input(name).process for name in ("left", "operator_camera")} if recoded else set()
    )
    assert cameras == kept
    names = {row.name for row in table.processes}
    assert names - kept == {row.name for row in SESSION.processes} - CAPTURES - {"stereo"}
    assert table.process("robot").writes == ()
    for name in PICTURES:
        media, sender = SESSION.video(name), table.process(table.media(name).sender)
        if not recoded:
            assert (sender.run, sender.arguments) == SCRIPT
            assert (sender.reads, sender.writes) == ((media.backlog_topic,), (media.sent_topic,))
            continue
        topic = SESSION.input(media.inputs[0]).topic
        assert sender.run == SESSION.process(SESSION.media("downlink_video").sender).run
        assert sender.arguments == {"stream": media.stream, "topic": topic}
        assert table.topic(topic).readers[0] == sender.name
        assert table.process(table.topic(topic).writer).run == SCRIPT.run
