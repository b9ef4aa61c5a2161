"""FFmpeg plays the Matroska files of an export without an error."""

import shutil
import subprocess

import pytest
from synthetic_recording import write_recording

from pipelines.cli import main

pytestmark = [
    pytest.mark.interop,
    pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="ffmpeg: apt-get install ffmpeg"),
]


def test_every_film_is_decoded_without_an_error(tmp_path):
    recording = write_recording(tmp_path / "a.mcap", parts=2)
    assert main(["export", str(recording.paths[0]), "--mkv", str(tmp_path / "mkv")]) == 0
    for path in (tmp_path / "mkv").iterdir():
        # These keep the instants as they are.
        ends = ["-fps_mode", "passthrough", "-enc_time_base", "-1", "-f", "null", "-"]
        done = subprocess.run(
            ["ffmpeg", "-v", "error", "-xerror", "-i", str(path), *ends],
            capture_output=True,
            text=True,
            timeout=60,
        )
        assert (path.name, done.returncode, done.stderr) == (path.name, 0, "")
