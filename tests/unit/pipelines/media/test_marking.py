"""The mark on stale pictures: red on the edge, and the age in words."""

import numpy as np
import pytest

from kontur_av.clock import NS_PER_MS as MS
from kontur_av.media import CaptureStamp, VideoFrame, empty_picture, planes
from kontur_av.sources.stereo import PicturePair
from pipelines.media.marking import PictureComposer, age_words, mark_stale
from pipelines.session.setup.composition import STEREO_PAIR, Composition


def grey(width, height):
    picture = empty_picture(width, height)
    picture[:] = 128
    return picture


@pytest.mark.parametrize("size", [(640, 480), (16, 16), (1920, 1080), (20, 600)])
def test_the_mark_is_red_on_the_edge_and_leaves_the_middle(size):
    width, height = size
    picture = grey(*size)
    mark_stale(picture, 1_300 * MS)
    luma, u, v = planes(picture)
    assert (luma[-1, 0], u[-1, 0], v[-1, 0]) == (81, 90, 240)
    assert luma[height // 2, width // 2] == 128
    if width == 640:
        assert np.count_nonzero(luma[:48] == 235) > 200, "the words"


def test_an_age_is_formatted_for_people():
    ages = {0: "0 ms", 340: "340 ms", 1_300: "1.3 s", 75_000: "75 s", -1_000: "age unknown"}
    assert {age_ms: age_words(age_ms * MS) for age_ms in ages} == ages
    assert age_words(None) == "age unknown"


PAIR = ("head", "wrist")
BESIDE, INSET = Composition(compose=PAIR), Composition(compose=PAIR, layout="inset", share=0.25)
UPPER = Composition(compose=PAIR, layout="inset", share=0.25, corner="upper left")


def composed(composition, old=None, missing=None):
    """The luma of a picture of 640x480 of two: 50 and 150, of which one may be old or missing."""
    frames = []
    for level in (50, 150):
        picture = empty_picture(640, 480)
        picture[:] = level
        frames.append(VideoFrame(picture, CaptureStamp(0, 0, "x")))
    if missing is not None:
        frames[missing] = None
    pair = PicturePair(*frames, CaptureStamp(0, 0, "both"), old == 0, old == 1)
    into = empty_picture(640, 480)
    into[:] = 77
    PictureComposer(composition).handle_pair(pair, into, 1_300 * MS)
    assert old is not None or not (into == 77).any()
    return planes(into)


@pytest.mark.parametrize(
    ("composition", "first", "second", "black"),
    [
        (STEREO_PAIR, (240, 100), (240, 500), None),
        (BESIDE, (240, 100), (240, 500), (60, 320)),
        (INSET, (300, 400), (479, 639), None),
        (UPPER, (479, 639), (100, 140), None),
    ],
)
def test_each_part_is_where_the_layout_has_it(composition, first, second, black):
    luma = composed(composition)[0]
    assert (luma[first], luma[second]) == (50, 150) and (black is None or luma[black] == 16)
    # A camera that is missing leaves the other one as it is.
    for missing, seen in ((0, second), (1, first)):
        luma = composed(composition, missing=missing, old=missing)[0]
        assert luma[seen] == (150 if missing == 0 else 50)


@pytest.mark.parametrize("composition", [STEREO_PAIR, BESIDE, INSET, UPPER])
@pytest.mark.parametrize("old", [0, 1])
def test_only_the_part_that_is_old_is_marked(composition, old):
    marked = [
        now != fresh
        for now, fresh in zip(composed(composition, old), composed(composition), strict=True)
    ]
    x, y, width, height = composition.areas(640, 480)[old]
    for plane, share in zip(marked, (1, 2, 2), strict=True):
        inside = plane[y // share : (y + height) // share, x // share : (x + width) // share]
        assert inside.sum() == plane.sum() > 0
        assert marked[0][y + height - 1, x + width // 3]
