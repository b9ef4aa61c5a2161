"""A camera that cannot work is refused before anything has started."""

import threading

import pytest

from kontur_av.errors import ConfigError
from kontur_av.sources import camera, check_spec


def test_a_device_that_is_no_camera_is_refused():
    with pytest.raises(ConfigError, match="'/dev/null' cannot be opened"):
        check_spec("v4l2:/dev/null", "video")


def test_a_driver_that_hangs_is_refused(monkeypatch):
    over = threading.Event()

    def hang(*_, **__):
        over.wait()
        raise OSError

    monkeypatch.setattr(camera.av, "open", hang)
    monkeypatch.setattr(camera, "_OPEN_TIMEOUT_S", 0.01)
    with pytest.raises(ConfigError, match="does not answer"):
        check_spec("v4l2:/dev/null", "video")
    over.set()
