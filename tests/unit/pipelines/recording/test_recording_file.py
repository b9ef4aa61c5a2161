"""Recordings are for their user alone, and of two programs that write one file none is torn."""

import os
import stat
from dataclasses import replace
from types import SimpleNamespace

import pytest

from kontur_av.errors import ConfigError
from pipelines.recording.part_files import PartFiles, check_disk, check_recordable, recorded_cameras
from pipelines.recording.recording_file import Outputs, write_whole
from pipelines.session.setup.setup_file import BUILT_IN


def test_recordings_are_for_their_user_alone(tmp_path):
    old = os.umask(0)
    try:
        write_whole(tmp_path / "whole.mcap", [b"x"], overwrite=False)
        files = PartFiles(tmp_path / "parts.mcap")
        files.open()
    finally:
        os.umask(old)
    modes = {path.name: stat.S_IMODE(path.stat().st_mode) for path in tmp_path.iterdir()}
    assert len(modes) == 2 and set(modes.values()) == {0o600}, modes


def pieces(path, *, overwrite):
    """Octets of a file that another program writes meanwhile, too."""
    yield b"one"
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(os, "getpid", lambda: 7)
        write_whole(path, [b"two"], overwrite=overwrite)
    yield b" whole"


def test_of_two_that_write_one_file_the_later_is_refused_or_replaces_it(tmp_path):
    path = tmp_path / "a.mcap"
    with pytest.raises(ConfigError, match="was written by another program meanwhile"):
        write_whole(path, pieces(path, overwrite=False), overwrite=False)
    assert path.read_bytes() == b"two"
    write_whole(path, pieces(path, overwrite=True), overwrite=True)
    assert path.read_bytes() == b"one whole"
    csv = tmp_path / "a.csv"
    with pytest.raises(ConfigError, match="meanwhile"), Outputs(overwrite=False) as outputs:
        unfinished = outputs.unfinished(csv)
        unfinished.write_bytes(b"one")
        csv.write_bytes(b"two")
    assert csv.read_bytes() == b"two"
    assert {each.name for each in tmp_path.iterdir()} == {"a.mcap", "a.csv"}


def test_a_recording_that_goes_on_is_not_overwritten_and_a_disk_needs_room(tmp_path):
    files = PartFiles(tmp_path / "a.mcap")
    files.open()
    with pytest.raises(ConfigError, match=r"a\.mcap is being recorded: record to another name"):
        check_recordable(tmp_path / "a.mcap", overwrite=True)
    files.close(1)
    check_recordable(tmp_path / "a.mcap", overwrite=True)
    setup = BUILT_IN["taskboard"]
    whole = recorded_cameras(tmp_path / "a.mcap", setup, "all")
    check_disk(tmp_path / "a.mcap", whole, 1.0)
    with pytest.raises(ConfigError, match=r"all 3 take up to 35 MB a minute, .*cameras carried"):
        check_disk(tmp_path / "a.mcap", whole, 1e12)
    check_disk(tmp_path / "a.mcap", recorded_cameras(tmp_path, setup, "carried"), 1e12)


@pytest.mark.parametrize(
    ("setup", "asked", "free_mb", "choice"),
    [
        ("auto", "", 3000, "all"),
        ("auto", "", 1000, "carried"),
        ("auto", "all", 1000, "all"),
        ("auto", "carried", 3000, "carried"),
        ("carried", "", 3000, "carried"),
        ("carried", "all", 3000, "all"),
    ],
)
def test_all_cameras_are_recorded_where_the_disk_has_room_for_an_hour(
    monkeypatch, tmp_path, setup, asked, free_mb, choice
):
    # Three cameras of the task board take 2.1 GB an hour.
    usage = SimpleNamespace(free=free_mb * 1_000_000)
    monkeypatch.setattr("shutil.disk_usage", lambda path: usage)
    found = recorded_cameras(
        tmp_path, replace(BUILT_IN["taskboard"], recorded_cameras=setup), asked
    )
    assert found.choice == choice
    assert "all 3 take up to 35 MB a minute" in found.words
