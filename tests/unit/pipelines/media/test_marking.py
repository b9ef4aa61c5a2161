"""The mark on stale pictures: red on the edge, and the age in words."""

from dataclasses import replace

import numpy as np
import pytest

from kontur_av.clock import NS_PER_MS as MS
from kontur_av.media import CaptureStamp, VideoFrame, empty_picture, planes
from kontur_av.sources.stereo import PicturePair
from pipelines.media.marking import PictureComposer, age_words, mark_stale
from pipelines.session.setup.composition import STEREO_PAIR, Composition

STAMP = CaptureStamp(0, 0, "x")


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


BESIDE = Composition(compose=("head", "wrist"))
INSET = replace(BESIDE, layout="inset", share=0.25)
UPPER = replace(INSET, corner="upper left")


def composed(composition, old=None, missing=None):
    """The planes of a picture of 640x480 of two: 50 and 150, of which one may be old or missing."""
    frames = [VideoFrame(grey(640, 480) // 128 * level, STAMP) for level in (50, 150)]
    if missing is not None:
        frames[missing] = None
    into = grey(640, 480)
    pair = PicturePair(*frames, STAMP, old == 0, old == 1)
    PictureComposer(composition).handle_pair(pair, into, 1_300 * MS)
    assert old is not None or not (into[:480] == 128).any()
    return planes(into)


@pytest.mark.parametrize(
    ("composition", "first", "second"),
    [
        (STEREO_PAIR, (240, 100), (240, 500)),
        (BESIDE, (240, 100), (240, 500)),
        (INSET, (300, 400), (479, 639)),
        (UPPER, (479, 639), (100, 140)),
    ],
)
def test_each_part_is_in_its_place_and_only_an_old_one_is_marked(composition, first, second):
    fresh = composed(composition)
    assert (fresh[0][first], fresh[0][second]) == (50, 150)
    for old, other, level in ((0, second, 150), (1, first, 50)):
        x, y, width, height = composition.areas(640, 480)[old]
        for share, was, now in zip((1, 2, 2), fresh, composed(composition, old), strict=True):
            marked = was != now
            inside = marked[y // share : (y + height) // share, x // share : (x + width) // share]
            assert inside.sum() == marked.sum() > 0 and inside[-1, inside.shape[1] // 3]
        # A camera that is missing leaves the other one as it is.
        assert composed(composition, old=old, missing=old)[0][other] == level
