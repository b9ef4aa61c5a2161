"""The recording that other tests read is one: whole, with every kind of message, in parts."""

import numpy as np
import pytest
from mcap.reader import make_reader
from synthetic_recording import BEGIN_NS, S, wall_ns, write_recording

from pipelines.recording.inventory import take_inventory
from pipelines.recording.messages import unpack_haptics

KINDS = ("telecommand", "telemetry")


@pytest.mark.parametrize("parts", [1, 2])
def test_any_reader_finds_what_was_told(tmp_path, parts):
    recording = write_recording(tmp_path / "a.mcap", parts=parts)
    assert [path.name for path in recording.paths] == ["a.mcap", "a-2.mcap"][:parts]
    found = {topic: [] for topic in recording.told}
    for number, path in enumerate(recording.paths, start=1):
        inventory = take_inventory(memoryview(path.read_bytes()))
        assert inventory.scan.figures.sound
        assert inventory.facts.part == number
        with path.open("rb") as file:
            for _, channel, message in make_reader(file).iter_messages():
                found[channel.topic].append((message.log_time, message.sequence, message.data))
    for topic, told in recording.told.items():
        assert found[topic] == [(wall_ns(one.log_ns), one.sequence, one.data) for one in told]
    # The synthetic recorder codes one camera of its own; telecommands only go down.
    empty = {each.topic for each in inventory.channels if not each.messages} - {*recording.told}
    assert empty == {
        *(f"/camera/{name}" for name in ("left", "right", "static", "iss_camera")),
        *(f"/{kind}/{end}/local" for kind in KINDS for end in ("space", "ground")),
        *("/telecommand/ground/sent", "/telecommand/space/received"),
        *("/telemetry/space/sent", "/telemetry/ground/received"),
    }


def test_every_part_begins_with_a_key_picture_of_each_stream(tmp_path):
    recording = write_recording(tmp_path / "a.mcap", parts=3)
    for units in recording.units.values():
        keys = {unit.capture_ns for unit in units if unit.key}
        assert {BEGIN_NS, BEGIN_NS + S, BEGIN_NS + 2 * S} <= keys
        assert len({unit.width for unit in units}) == 2


def test_haptic_cycles_of_both_ends_fit_together(tmp_path):
    recording = write_recording(tmp_path / "a.mcap", seconds=2)
    blocks = [unpack_haptics(told.data) for told in recording.told["/haptic/up/sent"]]
    sent = np.concatenate(blocks)
    assert np.array_equal(sent, recording.haptics["/haptic/up/sent"])
    assert len(recording.contacts) == 2
    acted_on = recording.haptics["/haptic/up/received"]
    assert np.array_equal(acted_on["fx_n"][11:], sent["fx_n"][acted_on["sequence"][11:]])
