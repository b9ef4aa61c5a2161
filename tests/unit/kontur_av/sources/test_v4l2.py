"""Which format, size and rate a camera is asked for."""

import pytest

from kontur_av.sources.v4l2 import CameraMode, choose_mode

VGA, HD = (640, 480), (1280, 720)
#: A webcam: raw pictures are slow where they are large, JPEGs are not.
WEBCAM = [
    *(CameraMode("YUYV", *VGA, fps) for fps in (30, 15)),
    *(CameraMode("YUYV", *HD, fps) for fps in (10, 5)),
    *(CameraMode("MJPG", *size, fps) for size in (VGA, HD) for fps in (60, 30)),
    CameraMode("H264", 1920, 1080, 30),
]


@pytest.mark.parametrize(
    ("size", "fps", "mode"),
    [
        (VGA, 30, ("YUYV", *VGA, 30)),
        (VGA, 60, ("MJPG", *VGA, 60)),
        ((320, 240), 10, ("YUYV", *VGA, 15)),
        (HD, 25, ("MJPG", *HD, 30)),
        (HD, 10, ("YUYV", *HD, 10)),
        ((1920, 1080), 30, ("MJPG", *HD, 30)),
    ],
)
def test_jpegs_are_asked_for_where_they_give_the_rate(size, fps, mode):
    assert choose_mode(WEBCAM, CameraMode("", *size, fps)) == mode
    assert choose_mode(WEBCAM[-1:], CameraMode("", *size, fps)) is None
    untold = [each._replace(fps=0.0) for each in WEBCAM]
    assert choose_mode(untold, CameraMode("", *HD, 30))[1:3] == HD
