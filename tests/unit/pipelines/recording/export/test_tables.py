"""Tables of a recording: each sample with what became of it, each event with its haptic row."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from synthetic_recording import (
    BEGIN_NS,
    LINK_CYCLES,
    METADATA_OF_SYNTHETIC,
    MS,
    Coded,
    S,
    octets_of_part,
    picture,
    write_recording,
)

from pipelines.recording.channels import channels_of
from pipelines.recording.export.columns import Columnizer, joined, table_names
from pipelines.recording.export.tables import TableCollector, haptic_tables, rows_of_haptics
from pipelines.recording.joined import JoinedMessage, JoinedRecording, read_part
from pipelines.recording.recorded_messages import (
    EVENT,
    HAPTIC_SAMPLES,
    LINK_SENT,
    NO_SAMPLE,
    SAMPLE,
    pack_haptics,
)
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.table import topology_of


def read(recording):
    """The parts of a recording as one."""
    parts = [read_part(memoryview(path.read_bytes())) for path in recording.paths]
    return JoinedRecording(parts=parts)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    return write_recording(tmp_path_factory.mktemp("recording") / "a.mcap", parts=2)


@pytest.fixture(scope="module")
def tables(written):
    recording = read(written)
    collector = TableCollector(recording.begin_ns)
    for message in recording.messages():
        collector.handle_message(message)
    assert not collector.columnizer.unreadable
    return collector.tables()


def test_parts_are_joined_and_each_sample_says_when_the_other_end_acted_on_it(written, tables):
    for key in ("up", "down"):
        table, cycles = tables[f"haptic_{key}"], written.haptics[f"/haptic/{key}/sent"]
        assert np.array_equal(table["session_ns"], cycles["time_ns"])
        for name in cycles.dtype.names[1:]:
            assert np.array_equal(table[name], cycles[name])
        assert table["time_s"] == pytest.approx((cycles["time_ns"] - BEGIN_NS) / S, abs=1e-12)
    received = tables["uplink_video_received"]
    assert len(received["time_s"]) == len(written.told["/uplink_video/received"])
    assert received["shows_loss"].sum() == 1
    table = tables["haptic_up"]
    late = table["delay_s"]
    assert np.isnan(late[-LINK_CYCLES:]).all()
    assert late[:-LINK_CYCLES] == pytest.approx(LINK_CYCLES / 1000 + 143e-9, abs=1e-9)
    acted_on = written.haptics["/haptic/down/received"]["sequence"]
    assert np.array_equal(table["acted_on"], acted_on)
    topic = "/link/uplink/sent"
    columnizer = Columnizer(BEGIN_NS)
    first, *_ = (one for one in written.told[topic])
    late = JoinedMessage(topic, LINK_SENT.full_name, 0, 0, 0, first.data, 0)
    early = late._replace(data=b"")
    columns = joined([columnizer.rows(early), columnizer.rows(late)])
    assert columns["carried_haptic_octets"].tolist() == [0, 0]
    assert columns["capacity_bps"].tolist() == [0, 256_000]


def test_events_and_commands_have_the_haptic_row_in_which_they_happened(written, tables):
    events = tables["events"]
    touches = [text == "touch" for text in events["what"]]
    rows = events["haptic_up_row"][touches].astype(int)
    cycles = tables["haptic_up"]
    # Counted from 1.
    assert [cycles["session_ns"][row - 1] for row in rows] == [at for at, _ in written.contacts]
    assert cycles["contact"][rows - 1].all()
    assert not cycles["contact"][rows - 2].any()
    commands = tables["commands"]
    selected = commands["what"].index("PUS 8,1 camera: select static")
    row = int(commands["haptic_down_row"][selected])
    assert 0 <= commands["session_ns"][selected] - tables["haptic_down"]["session_ns"][row - 1] < MS
    kinds = {*zip(commands["kind"], commands["way"], strict=True)}
    ways = ("sent", "received")
    assert kinds == {(kind, way) for kind in ("telecommand", "telemetry") for way in ways}


def cycles(instants_ms, sequences):
    """A haptic channel's columns."""
    instants = np.array([round(at * MS) for at in instants_ms], np.int64)
    return {"session_ns": instants, "sequence": np.array(sequences, np.int32)}


def test_a_number_that_comes_again_means_the_newest_sample_and_far_events_have_no_row():
    """Numbers have 16 bits: at 1 kHz the same one comes every 65.5 s."""
    sent = cycles([0, 1, 65_536, 65_537, 65_538], [0, 1, 0, NO_SAMPLE, 2])
    received = cycles([10, 11, 65_546, 65_547], [0, 0, 0, NO_SAMPLE])
    channels = {"/haptic/up/sent": sent, "/haptic/up/received": received}
    found = haptic_tables(channels, 0)["haptic_up"]["received_s"]
    assert np.array_equal(found, [0.01, np.nan, 65.546, np.nan, np.nan], equal_nan=True)
    haptics = {"haptic_up": cycles([100, 101], [0, 1])}
    events = cycles([99.9, 100, 101.5, 121, 121.1], [0] * 5)
    rows = rows_of_haptics(events, haptics)["haptic_up_row"]
    assert np.array_equal(rows, [np.nan, 1, 2, 2, np.nan], equal_nan=True)
    columnizer = Columnizer(0)
    message = JoinedMessage("/events", EVENT.full_name, 0, 0, 0, b"\xff", 0)
    assert columnizer.rows(message) is None
    assert columnizer.unreadable == {"/events": 1}
    assert columnizer.rows(message._replace(schema="some.Other")) is None


TOPICS = st.text("a_-/. 2é", min_size=1, max_size=4) | st.text("ab", min_size=60, max_size=70)


@given(st.lists(TOPICS | st.sampled_from(["/end", "END"]), unique=True, max_size=12))
def test_no_two_channels_have_one_table(topics):
    names = table_names(topics, taken=["a", "events"])
    assert len({*names.values(), "a", "events"}) == len(topics) + 2
    assert all(re.fullmatch("[a-z][a-z0-9_]{0,62}", name) for name in names.values())
    assert "end" not in names.values()


class Messages:
    """A part of these messages."""

    def __init__(self, instants_s):
        self._instants_s = instants_s

    def messages(self, part):
        for number, at_s in enumerate(self._instants_s):
            yield JoinedMessage("/a", "", round(at_s * S), round(at_s * S), number, b"", part)


def settled_s(instants_s):
    found = [*JoinedRecording(parts=[Messages(instants_s)]).messages()]
    assert [message.sequence for message in found] == [*range(len(instants_s))]
    return [message.session_ns / S for message in found], [message.moved for message in found]


WRONG_S = [0.0, 1400.0, 8600.0, 2**63 / S, 2**64 / S]


@given(st.dictionaries(st.sampled_from(range(10, 100, 10)), st.sampled_from(WRONG_S)))
def test_single_instants_far_from_all_others_are_moved(wrong):
    right = [5000 + 0.01 * number for number in range(100)]
    instants_s = [wrong.get(number, at_s) for number, at_s in enumerate(right)]
    found_s, moved = settled_s(instants_s)
    assert found_s == pytest.approx(right, abs=1)
    assert moved == [number in wrong for number in range(100)]


@given(st.lists(st.floats(0, 5000), min_size=1, max_size=99), st.integers(0, 20))
def test_pauses_stay(pauses_s, together):
    instants_s, at_s = [], 0.0
    for pause_s in pauses_s:
        at_s += pause_s
        instants_s += [at_s + 0.01 * number for number in range(together + 1)]
    found_s, moved = settled_s(instants_s)
    assert not any(moved)
    assert found_s == pytest.approx(instants_s, abs=1e-8)


def test_samples_an_hour_ahead_within_a_message_are_moved():
    time_ns = BEGIN_NS + np.arange(6) * MS
    for wrong in ([2, 3], [0], [*range(6)]):
        samples = np.zeros(6, SAMPLE)
        samples["time_ns"] = time_ns
        samples["time_ns"][wrong] += 3600 * S
        message = JoinedMessage(
            "/haptic/up/sent", HAPTIC_SAMPLES.full_name, BEGIN_NS, BEGIN_NS, 0, b"", 0
        )
        rows = Columnizer(BEGIN_NS).rows(message._replace(data=pack_haptics(samples)))
        assert np.abs(rows["session_ns"] - time_ns).max() <= MS

    # The first and the last instant of a recording may be wrong, too.
    for place, wrong_s in ((0, -2e9), (-1, 2**64 / S)):
        instants_s = [5000 + 0.01 * number for number in range(20)]
        instants_s[place] = wrong_s
        assert settled_s(instants_s)[0] == pytest.approx([5000] * 20, abs=1)


@pytest.mark.parametrize("first_ns", [(1 << 63) - 20 * MS, 1 << 63, (1 << 64) - S])
def test_messages_of_any_wall_time_that_a_file_can_hold_are_in_the_tables(monkeypatch, first_ns):
    rows = channels_of(topology_of(BUILT_IN["spacejustin"]))
    units = [Coded(number, number * 10 * MS, b"\0\0\0\1", False, 8, 8) for number in range(9)]
    monkeypatch.setattr("synthetic_recording.wall_ns", lambda at_ns: at_ns + first_ns)
    told = [picture("/camera/head", unit, unit.number, 0) for unit in units]
    octets = octets_of_part(rows, METADATA_OF_SYNTHETIC, told, end=True)
    with pytest.MonkeyPatch.context() as without:
        # Its facts are lost.
        without.setattr("pipelines.recording.inventory.METADATA", "none")
        recording = JoinedRecording(parts=[read_part(memoryview(octets))])
    collector = TableCollector(recording.begin_ns)
    for message in recording.messages():
        collector.handle_message(message)
    assert not collector.columnizer.unreadable
    assert collector.tables()["camera_head"]["time_s"] == pytest.approx(np.arange(9) / 100)
