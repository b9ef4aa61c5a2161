"""Every stream, camera, direction and end of a session has its channels, readable by any tool."""

import pytest
from google.protobuf import descriptor_pb2

from kontur_av.sources.recorded_format import FORMAT_KEY
from pipelines.recording.channels import channels_of
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.session.topology import Kind
from pipelines.table import topology_of

SESSIONS = [topology_of(setup) for setup in BUILT_IN.values()]


@pytest.mark.parametrize("session", SESSIONS, ids=lambda session: session.setup.name)
def test_everything_that_crosses_the_link_is_recorded_as_sent_and_as_received(session):
    topics = {row.topic for row in channels_of(session)}
    for stream in session.streams:
        if stream.kind in (Kind.VIDEO, Kind.VOICE):
            assert {f"/{stream.name}/sent", f"/{stream.name}/received"} <= topics
    assert {
        f"/{kind}/{end}/{way}"
        for kind in ("telecommand", "telemetry")
        for end in ("space", "ground")
        for way in ("sent", "received", "local")
    } <= topics
    assert {
        f"/haptic/{key}/{way}" for key in ("up", "down") for way in ("sent", "received")
    } <= topics
    assert {
        f"/link/{way}/{end}" for way in ("uplink", "downlink") for end in ("sent", "received")
    } <= topics


def test_every_camera_has_a_channel_of_its_own():
    session = topology_of(BUILT_IN["spacejustin"])
    cameras = {row.topic for row in channels_of(session) if row.topic.startswith("/camera/")}
    names = {row.name for row in session.inputs if session.media(row.stream).kind is Kind.VIDEO}
    assert cameras == {f"/camera/{name}" for name in names}
    assert len(names) == 5


@pytest.mark.parametrize("session", SESSIONS, ids=lambda session: session.setup.name)
def test_records_say_what_they_are(session):
    rows = channels_of(session, link_frames=True)
    assert [row.number for row in rows] == [*range(1, len(rows) + 1)]
    assert len({row.topic for row in rows}) == len(rows)
    schemas = {}
    for row in rows:
        schema, channel = row.records()
        assert (channel.id, channel.topic, channel.schema_id) == (row.number, row.topic, schema.id)
        assert channel.metadata == {"what": row.what, FORMAT_KEY: "1"}
        assert schemas.setdefault(schema.id, schema) == schema
        *_, file = descriptor_pb2.FileDescriptorSet.FromString(schema.data).file
        assert f"{file.package}.{file.message_type[0].name}" == schema.name


def test_frames_of_the_link_are_recorded_only_if_asked_for():
    session = topology_of(BUILT_IN["taskboard"])
    more = {row.topic for row in channels_of(session, link_frames=True)}
    assert {topic for topic in more if "/frames/" in topic} == more - {
        row.topic for row in channels_of(session)
    }
