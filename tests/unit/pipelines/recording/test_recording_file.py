"""Recordings have pictures, voices and the hand, so they are for their user alone."""

import os
import stat

from pipelines.recording.part_files import PartFiles
from pipelines.recording.recording_file import write_whole


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
