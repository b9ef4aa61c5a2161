"""Of the files of a recording all is read that can be read, and what cannot is named."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from recordings import LIBRARY, METADATA_OF_A_TEST, channel

from kontur_av.errors import ConfigError
from pipelines.recording.mcap_stream import McapStream
from pipelines.recording.metadata import METADATA
from pipelines.recording.part_files import check_recordable, clear_parts, part_path
from pipelines.recording.recorded_parts import read_recording

PART_NS = 10**9
ROWS = 5


def octets_of(part, **metadata):
    """Part `part` of a recording: as many messages, each in a chunk of its own."""
    begin_ns = METADATA_OF_A_TEST.session_ns + part * PART_NS
    offset_ns = METADATA_OF_A_TEST.wall_ns - METADATA_OF_A_TEST.session_ns
    changed = {"part": part, "session_ns": begin_ns, "wall_ns": begin_ns + offset_ns} | metadata
    stream = McapStream(library=LIBRARY)
    stream.handle_metadata(METADATA, replace(METADATA_OF_A_TEST, **changed).items())
    stream.handle_channel(*channel(0))
    for row in range(ROWS):
        at_ns, wall_ns = row * PART_NS // ROWS, begin_ns + offset_ns + row
        stream.handle_message(
            0, b"x", log_ns=wall_ns, publish_ns=wall_ns, sequence=part * 100 + row, now_ns=at_ns
        )
    stream.handle_end()
    octets = b""
    while (piece := stream.poll_transmit(PART_NS)) is not None:
        octets += piece
    return octets


PARTS = [octets_of(part) for part in range(1, 6)]
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
#: What a file may have become, and how many of its rows are left.
FATES = {
    "whole": (lambda octets: octets, ROWS),
    "empty": (lambda _: b"", 0),
    "no recording": (lambda _: b"RIFF and more", 0),
    "gone": (lambda _: None, 0),
    "cut": (lambda octets: octets[: octets.rindex(ZSTD_MAGIC) + 8], ROWS - 1),
    "without facts": (lambda octets: octets[:60] + bytes(9) + octets[69:], ROWS),
}


@given(st.permutations(range(5)), st.lists(st.sampled_from([*FATES]), min_size=5, max_size=5))
def test_all_rows_that_can_be_read_come_in_order_and_the_rest_is_named(
    tmp_path_factory, order, fates
):
    first = tmp_path_factory.mktemp("parts") / "a.mcap"
    wanted, troubled = [], []
    for number, (part, fate) in enumerate(zip(order, fates, strict=True), start=1):
        change, rows = FATES[fate]
        octets = change(PARTS[part])
        if octets is not None:
            part_path(first, number).write_bytes(octets)
        wanted += [(part + 1) * 100 + row for row in range(rows)]
        if not rows:
            troubled.append(number)
    with pytest.MonkeyPatch.context() as patched:
        told = []
        patched.setattr("builtins.print", lambda line, **_: told.append(line))
        if not {"whole", "cut"} & {*fates}:
            return
        part_path(first, 6).write_bytes(octets_of(6, started_ns=7))
        paths, recording = read_recording(first)
    assert [message.sequence for message in recording.messages()] == sorted(wanted)
    assert len(paths) == 5 - len(troubled)
    assert part_path(first, 6).name in told.pop()
    named = "\n".join(told)
    ends = [number for number in range(1, 6) if part_path(first, number) in paths]
    for number in troubled:
        if part_path(first, number).exists() or min(ends) < number < max(ends):
            assert f"{part_path(first, number)}" in named
    assert len(told) <= len(troubled) + (1 not in ends)


def test_a_copy_of_a_part_is_left_out_and_of_nothing_there_is_no_recording(tmp_path, capsys):
    first = tmp_path / "a.mcap"
    for number in (1, 2):
        part_path(first, number).write_bytes(PARTS[0])
    paths, _ = read_recording(first)
    assert paths == [first]
    assert "a-2.mcap is left out: part 1 is there already" in capsys.readouterr().err

    for number in (1, 3):
        part_path(first, number).write_bytes(b"")
    part_path(first, 2).unlink()
    with pytest.raises(ConfigError, match=r"a\.mcap: it is not an MCAP file$"):
        read_recording(first)


def test_overwriting_removes_only_what_is_of_the_same_session(tmp_path):
    first = tmp_path / "a [1].mcap"
    others = {2: octets_of(2, session="another"), 4: octets_of(1, started_ns=7), 5: b"notes"}
    for number, octets in (others | {1: PARTS[0], 3: PARTS[2], 6: b""}).items():
        part_path(first, number).write_bytes(octets)
    with pytest.raises(ConfigError, match="exists: give another name, or --overwrite"):
        check_recordable(first, overwrite=False)
    check_recordable(first, overwrite=True)
    clear_parts(first)
    assert {path.name for path in tmp_path.iterdir()} == {
        part_path(first, number).name for number in others
    }
    clear_parts(first)
    assert len([*tmp_path.iterdir()]) == len(others)


@pytest.mark.parametrize(
    ("number", "spec"), [(1, "mcap:{}#/camera/head"), (3, "mcap:{}"), (1, "{}")]
)
def test_a_source_of_the_session_is_not_overwritten(tmp_path, number, spec):
    first, link = tmp_path / "a.mcap", tmp_path / "link"
    for part in (1, 3):
        part_path(first, part).write_bytes(PARTS[part - 1])
    link.symlink_to(part_path(first, number))
    for overwrite in (True, False):
        with pytest.raises(ConfigError, match="is a source of this session"):
            check_recordable(first, overwrite=overwrite, sources=["scene:x", spec.format(link)])
