"""Files as cameras of a simulated session: read ahead, and coded when there is room."""

from fractions import Fraction

import av
import pytest

from kontur_av.codecs.coding import Coding
from pipelines.session.setup.table import VideoStream
from pipelines.virtual.studio import Shot, VideoStudio

SIZE = 64, 48
STREAM = VideoStream(name="uplink_video", cap_bps=100_000, width=SIZE[0], height=SIZE[1])


@pytest.mark.parametrize("step_ms", [1, 33])
@pytest.mark.parametrize("waits", [1, 15, 16, 30])
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
        data, _ = studio(((Shot("head", sequence, None),), Coding(), None))
        assert data
