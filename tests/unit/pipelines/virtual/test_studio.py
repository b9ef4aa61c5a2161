"""Pictures and sounds of a simulated session; what is prepared early changes nothing."""

from fractions import Fraction

import av
import pytest

from kontur_av.codecs.coding import Coding
from pipelines.session.setup.table import VideoStream
from pipelines.virtual.studio import Shot, VideoStudio
from telepresence.world import WorldState

SIZE = 64, 48
STREAM = VideoStream(name="uplink_video", cap_bps=100_000, width=SIZE[0], height=SIZE[1])


@pytest.mark.parametrize(("step_ms", "waits"), [(1, 1), (1, 30), (33, 15), (33, 16)])
def test_a_picture_of_a_fast_file_may_wait_for_its_encoder(tmp_path, step_ms, waits):
    path = tmp_path / "fast.mkv"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("rawvideo", rate=1000)
        stream.width, stream.height, stream.pix_fmt = *SIZE, "yuv420p"
        for number in range(60):
            frame = av.VideoFrame(*SIZE, "yuv420p")
            frame.pts, frame.time_base = number * step_ms, Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    studio = VideoStudio(STREAM, {"head": str(path)}, 0)
    captured_ns = [studio("head") for _ in range(waits + 1)]
    assert captured_ns == sorted(captured_ns)
    for sequence in (0, waits):
        assert studio((Shot("head", sequence, None), Coding(), None)).data


def test_a_picture_that_was_drawn_ahead_is_coded_as_one_that_was_not():
    early, late = (VideoStudio(STREAM, {"left": "scene:left"}, 0) for _ in range(2))
    for number in range(8):
        shot = Shot("left", number, WorldState(time_ns=0, x_m=number / 1000))
        early(shot)
        if number % 3 == 2:  # the next one is drawn before this one is encoded
            early(Shot("left", number + 1, WorldState(time_ns=0, x_m=(number + 1) / 1000)))
        job = shot, Coding(), None
        assert early(job) == late(job)
