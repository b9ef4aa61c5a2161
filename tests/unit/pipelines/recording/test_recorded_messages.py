"""Any value of a recording comes back from its octets; its schema tells other tools the fields."""

import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from kontur_av.media import CaptureStamp, Quality
from kontur_av.streams.coded_unit import CodedUnit
from pipelines.hand.haptic_trace import ROW, row_type
from pipelines.recording.recorded_messages import (
    HAPTIC_SAMPLES,
    NO_SAMPLE,
    SAMPLE,
    SCHEMAS,
    RecordedEvent,
    RecordedFrames,
    UnitMetadata,
    haptic_samples,
    pack,
    pack_haptics,
    unpack,
    unpack_haptics,
)
from pipelines.recording.schemas import descriptor_set

INSTANT = st.integers(-(1 << 63), (1 << 63) - 1)


@given(st.lists(st.tuples(INSTANT, st.binary(max_size=40)), max_size=5), INSTANT, st.text())
def test_any_instants_octets_and_texts_come_back(frames, at_ns, text):
    """`tests/vectors/test_recording_messages.py` has an example of each message."""
    instants, data = zip(*frames, strict=True) if frames else ((), ())
    block = RecordedFrames(time_ns=instants, data=data)
    assert unpack(RecordedFrames, pack(block)) == block
    event = RecordedEvent(session_ns=at_ns, number=1 << 31, what=text, text="a\udcff")
    found = unpack(RecordedEvent, pack(event))
    assert (found.session_ns, found.number) == (at_ns, 1 << 31)
    # Malformed Unicode is written with question marks.
    assert (found.what, found.text) == (text, "a?")


@given(arrays(SAMPLE, st.integers(0, 40)))
def test_any_haptic_samples_come_back(samples):
    back = unpack_haptics(pack_haptics(samples))
    for name in SAMPLE.names:
        assert np.array_equal(back[name], samples[name], equal_nan=name not in ("time_ns", "flags"))


def test_another_tool_reads_a_message_by_the_schema():
    for schema in SCHEMAS:
        files = descriptor_pb2.FileDescriptorSet.FromString(descriptor_set(schema)).file
        pool = descriptor_pool.DescriptorPool()
        for file in files:
            pool.Add(file)
        found = pool.FindMessageTypeByName(schema.full_name)
        assert [field.name for field in found.fields] == [row.name for row in schema.fields]
        assert [field.number for field in found.fields] == [*range(1, len(schema.fields) + 1)]
        assert all(row.what for row in schema.fields)
    assert message_factory.GetMessageClass(found) is not None
    assert {*SAMPLE.names} <= {row.name for row in HAPTIC_SAMPLES.fields}


def test_rows_of_the_trace_become_samples_and_a_unit_has_facts():
    rows = np.zeros(3, ROW)
    rows["time_ns"], rows["x_m"], rows["flags"] = (1, 2, 3), (0.1, 0.2, 0.3), (1, 2, 4)
    samples = haptic_samples(rows)
    assert samples["sequence"].tolist() == [NO_SAMPLE] * 3
    assert all((samples[name] == rows[name]).all() for name in ROW.names[:-2])
    assert haptic_samples(rows, np.array([7, 8, -1], np.int32))["sequence"].tolist() == [7, 8, -1]
    rows = np.zeros(3, row_type(["z_m", "pan_rad"]))
    rows["z_m"], rows["pan_n_m"] = (0.0, 0.5, 0.0), (0.25, 0.0, -0.25)
    samples = unpack_haptics(pack_haptics(haptic_samples(rows)))
    assert samples["z_m"].tolist() == [0.0, 0.5, 0.0]
    assert samples["pan_n_m"].tolist() == [0.25, 0.0, -0.25]
    assert "gripper_m" not in samples.dtype.names
    unit = CodedUnit(data=b"12345", key=True, damaged=True, width=64, height=48)
    metadata = UnitMetadata.of(unit, CaptureStamp(9, 1, "uplink_video", Quality.DAMAGED))
    assert (metadata.capture_ns, metadata.width_px, metadata.height_px, metadata.octets) == (
        9,
        64,
        48,
        5,
    )
    assert metadata.key and metadata.damaged and metadata.shows_loss and metadata.dated
    assert not (metadata.refused or metadata.added)
