"""Cuts are detected by an unusual change, and pictures are small while cuts come fast."""

import numpy as np

from kontur_av.codecs.cuts import CALM, RARE, Cuts
from kontur_av.codecs.h264 import H264Decoder, H264Encoder
from kontur_av.media import CaptureStamp, VideoFrame


def views(*lengths, change=2.0):
    """Return thumbnails of one view after the other, each changing by `change` a picture."""
    rng = np.random.default_rng(1)
    for length in lengths:
        view = rng.uniform(40, 200, (30, 40))
        for _ in range(length):
            moved = view + rng.choice((-1, 1), view.shape) * change
            yield np.clip(moved, 0, 255).astype(np.uint8)


def test_a_rare_cut_keeps_the_size_and_fast_ones_do_not():
    cuts = Cuts()
    restless = [cuts.handle_picture(view) for view in views(200, RARE + 1, 40, 40, CALM + 10)]
    assert cuts.found == 4
    changes = [n for n in range(1, len(restless)) if restless[n] != restless[n - 1]]
    assert changes == [201 + RARE + 40, 201 + RARE + 80 + CALM + 1]
    assert restless[changes[0]]


def test_constant_change_is_no_cut():
    cuts = Cuts()
    assert not any(cuts.handle_picture(view) for view in views(300, change=18.0))
    assert cuts.found == 0


def test_repeatedly_requested_key_pictures_are_small():
    cuts = Cuts()
    asked = {150, 150 + RARE + 1, 150 + RARE + 31}
    restless = [
        cuts.handle_picture(view, key=n in asked) for n, view in enumerate(views(150 + RARE + 90))
    ]
    assert restless.index(True) == 150 + RARE + 31
    assert all(restless[restless.index(True) :])


def test_footage_full_of_cuts_is_coded_small_and_they_are_on_time(pictures):
    encoder = H264Encoder(width=640, height=480, fps=30, cap_bps=85_000, refresh_s=20)
    decoder = H264Decoder()
    sizes, octets = [], []
    for n, picture in enumerate(pictures("bikes.mp4", 250)):
        unit = encoder.encode(VideoFrame(picture, CaptureStamp(n, n, "t")))
        (shown,) = decoder.decode(unit.data, n)
        sizes.append((shown.width, shown.height))
        octets.append(len(unit.data))
    small = sizes.index((256, 192))
    assert set(sizes[:small]) == {(384, 288)} and set(sizes[small:]) == {(256, 192)}
    share = 85_000 / 30 / 8
    assert max(octets[1:small]) > 1.8 * share
    assert max(octets[small:]) < 1.25 * share
    assert encoder.coded_size == (384, 288)
