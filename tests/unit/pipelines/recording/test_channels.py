"""Every stream, camera, direction and end of a session has its channels, readable by any tool."""

from itertools import product

import pytest
from google.protobuf import descriptor_pb2

from kontur_av.sources.recorded_format import FORMAT_KEY
from pipelines.recording.channels import channels_of
from pipelines.session.setup.segments import Segment
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.session.topology.rows import Kind
from pipelines.table import topology_of

SESSIONS = [topology_of(setup) for setup in BUILT_IN.values()]


@pytest.mark.parametrize("session", SESSIONS, ids=lambda session: session.setup.name)
def test_all_that_crosses_the_link_and_every_camera_is_recorded(session):
    topics = {row.topic for row in channels_of(session)}
    names = [stream.name for stream in session.streams if stream.kind in (Kind.VIDEO, Kind.VOICE)]
    both = [*names, "haptic/up", "haptic/down"]
    packets = product(("telecommand", "telemetry"), Segment, ("sent", "received", "local"))
    cameras = {row.name for row in session.inputs if session.media(row.stream).kind is Kind.VIDEO}
    assert topics >= {
        *(f"/{name}/{way}" for name in both for way in ("sent", "received")),
        *(f"/{kind}/{end.value}/{way}" for kind, end, way in packets),
        *(f"/link/{way}/{end}" for way in ("uplink", "downlink") for end in ("sent", "received")),
    }
    assert {topic for topic in topics if topic.startswith("/camera/")} == {
        f"/camera/{name}" for name in cameras
    }
    # Frames of the link only if asked for.
    more = {row.topic for row in channels_of(session, link_frames=True)}
    assert {one for one in more if "/frames/" in one} == more - topics != set()


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
