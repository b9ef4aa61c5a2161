"""A user's own camera and microphone, named by module and class."""

import sys

import numpy as np
import pytest

from kontur_av.clock import ManualClock
from kontur_av.errors import ConfigError
from kontur_av.media import empty_picture
from kontur_av.sources import open_audio, open_video
from kontur_av.sources.spec import check_spec

MODULE = """
from kontur_av.media import AudioFrame, CaptureStamp
import numpy as np

class Grey:
    faults, last_fault = 0, ""
    def __init__(self, name, width, height, fps, clock, level="7"):
        self.level, self.stamp = int(level), CaptureStamp(clock.now_ns(), 0, name)
    def read(self, into, timeout_ns):
        into.fill(self.level)
        return self.stamp
    def close(self): ...

class Quiet:
    faults, last_fault = 0, ""
    def __init__(self, name, clock):
        self.stamp = CaptureStamp(clock.now_ns(), 0, name)
    def read(self, timeout_ns):
        return AudioFrame(np.zeros(960, np.int16), self.stamp)
    def close(self): ...

broken = 3
"""


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    (tmp_path / "own_camera.py").write_text(MODULE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    yield
    sys.modules.pop("own_camera", None)


@pytest.mark.parametrize(("spec", "level"), [("own_camera:Grey", 7), ("own_camera:Grey:99", 99)])
def test_its_pictures_and_sounds_are_taken(spec, level):
    clock = ManualClock(5)
    check_spec(spec, "video")
    camera = open_video(spec, name="left", width=64, height=48, fps=30, clock=clock)
    into = empty_picture(64, 48)
    stamp = camera.read(into, 0)
    assert (stamp.source, stamp.capture_ns) == ("left", 5)
    np.testing.assert_array_equal(into, level)
    check_spec("own_camera:Quiet", "audio")
    assert len(open_audio("own_camera:Quiet", name="mic", clock=clock).read(0).samples) == 960


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        ("own_camera:None_such", "has no class"),
        ("own_camera:broken", "has no class"),
        ("no_camera:Grey", "no module 'no_camera'"),
    ],
)
def test_one_that_is_not_there_is_refused_before_anything_has_started(spec, words):
    with pytest.raises(ConfigError, match=words):
        check_spec(spec, "video")


def test_a_file_of_such_a_name_is_a_file(tmp_path):
    (tmp_path / "own_camera:Grey").write_bytes(b"no media")
    with pytest.raises(ConfigError, match="own_camera:Grey"):
        check_spec("own_camera:Grey", "video")
