"""SPS of other makers' encoders, and the pictures that ffprobe finds in them, before cropping."""

import pytest

from kontur_av.codecs.decoder_guard import CodedPicture, DecoderGuard, read_sps
from kontur_av.rtp.annex_b import join_annex_b

#: Encoder and profile, SPS, coded width and height, chroma_format_idc, bits.
VECTORS = [
    (
        "FFmpeg x264 Constrained Baseline",
        "h264",
        "6742c00dd90141fb011000000300100000030320f142a480",
        (320, 240, 1, 8),
    ),
    (
        "FFmpeg x264 High",
        "h264",
        "6764001ef3650280bfb8bc05b2000003000200000300641e2c5b2c",
        (640, 368, 0, 8),
    ),
    (
        "FFmpeg x265 Rext",
        "h265",
        "4201010408000003009fc800000300003fc0140805a77796566924caf016c080000003008000000c84",
        (640, 360, 0, 8),
    ),
    (
        "GStreamer x264 High 4:4:4 Predictive",
        "h264",
        "67f4001e90d9b281407b602d41818190000003001000000303c8f162d960",
        (640, 480, 3, 10),
    ),
    (
        "GStreamer x265 Main",
        "h265",
        "42010101600000030090000003000003005aa0050201e165959a4932bffc00040005a830303020000003002000000303c1",
        (640, 480, 1, 8),
    ),
    (
        "GStreamer x265 Rext",
        "h265",
        "4201010408000003009e0800000300005a9000a0403c2cb2b3492657ff80008000b5060606040000030004000003007820",
        (640, 480, 3, 8),
    ),
    (
        "GStreamer openh264enc Constrained Baseline",
        "h264",
        "6742c01e8c8d40501ed00f08846a",
        (640, 480, 1, 8),
    ),
    (
        "FFmpeg x264 High",
        "h264",
        "6764001eacd940a02fea6c0440000003004000000c83c58b6580",
        (640, 368, 1, 8),
    ),
    (
        "FFmpeg x264 High 10",
        "h264",
        "676e001ea6cd940a02fea6c044000003000400000300c83c58b658",
        (640, 368, 1, 10),
    ),
    (
        "FFmpeg x264 High 4:2:2",
        "h264",
        "677a001eb6cd940a02fea2f011000003000100000300320f162d96",
        (640, 368, 2, 10),
    ),
    (
        "FFmpeg x264 High 4:4:4 Predictive",
        "h264",
        "67f4001e919b281405fdc5e022000003000200000300641e2c5b2c",
        (640, 368, 3, 8),
    ),
    (
        "FFmpeg x264 High interlaced",
        "h264",
        "67640028acd94078044fde0220000003002000000643e2c5b2c0",
        (1920, 1088, 1, 8),
    ),
    (
        "FFmpeg x265 Rext",
        "h265",
        "420101040800000300998800000300003fa005020169d514a5959a4932bc05a02000000300200000030321",
        (640, 360, 1, 12),
    ),
    (
        "FFmpeg x265 Rext",
        "h265",
        "4201010408000003009d0800000300003fb005020169d5b65959a4932bc05a020000030002000003003210",
        (640, 360, 2, 10),
    ),
    (
        "FFmpeg x265 Rext",
        "h265",
        "4201010408000003009e0800000300003f9000a0402d3bbcb2b349265780b4040000030004000003006420",
        (640, 360, 3, 8),
    ),
    (
        "FFmpeg x264 Main",
        "h264",
        "674d4028eca03c0113f2e022000003000200000300641e30632c",
        (1920, 1088, 1, 8),
    ),
    (
        "FFmpeg x265 Main",
        "h265",
        "42010101600000030090000003000003003fa005020169d565959a4932bc05a02000000300200000030321",
        (640, 360, 1, 8),
    ),
    (
        "FFmpeg x265 Main 10",
        "h265",
        "42010102200000030090000003000003003fa005020169d5365959a4932bc05a020000030002000003003210",
        (640, 360, 1, 10),
    ),
    (
        "FFmpeg x264 High 4:4:4 Predictive",
        "h264",
        "67f4001e919b281405fdc5e02dc080801000000300100000030320f162d960",
        (640, 368, 3, 8),
    ),
    (
        "FFmpeg x265 Main",
        "h265",
        "42010101600000030040000003000003003fa005020169d565959a49395e02d0d00000030010000003019080",
        (640, 360, 1, 8),
    ),
    (
        "FFmpeg x265 Main 10",
        "h265",
        "420101022000000300900000030000030096a001e020021c4d965654a4c2f0168080000003008000000c84",
        (3840, 2160, 1, 10),
    ),
]


@pytest.mark.parametrize(("maker", "codec", "octets", "expected"), VECTORS)
def test_the_sps_of_others_are_read_and_pass(maker, codec, octets, expected):
    nal = bytes.fromhex(octets)
    assert read_sps(nal, codec) == CodedPicture(*expected)
    unit = join_annex_b([nal])
    assert DecoderGuard(codec).admit(unit) == unit
