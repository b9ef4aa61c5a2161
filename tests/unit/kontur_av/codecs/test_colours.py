"""Colours that FFmpeg cannot convert are taken as unspecified."""

from fractions import Fraction

import av
import pytest
from av.video.reformatter import VideoReformatter

from kontur_av.codecs.colours import as_i420
from kontur_av.codecs.h26x import H264Decoder


@pytest.mark.parametrize("form", ["yuv420p", "yuv422p", "yuv444p10le"])
def test_a_stream_of_such_colours_is_shown(form):
    coder = av.CodecContext.create("libx264", "w")
    coder.width, coder.height, coder.pix_fmt = 64, 48, form
    coder.time_base, coder.options = Fraction(1, 30), {"preset": "ultrafast"}
    coder.colorspace = 8  # YCgCo
    frame = av.VideoFrame(64, 48, form)
    for plane in frame.planes:
        # x264 writes beyond its tables for samples of more than 10 bits.
        plane.update(bytes(plane.buffer_size))
    (packet,) = [*coder.encode(frame), *coder.encode(None)]
    decoder = H264Decoder()
    (shown,) = [*decoder.decode(bytes(packet), 0), *decoder.drain()]
    assert shown.to_i420().shape == (72, 64)
    assert decoder.counts.frames_corrupt == 0


def test_every_matrix_is_converted():
    scaler = VideoReformatter()
    for matrix in range(20):
        frame = av.VideoFrame(64, 48, "yuv420p")
        frame.colorspace = matrix
        assert as_i420(scaler, frame, 32, 24, "BILINEAR").width == 32
