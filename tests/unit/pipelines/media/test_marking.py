"""The mark on stale pictures: red on the edge, and the age in words."""

import numpy as np
import pytest

from kontur_av.clock import NS_PER_MS as MS
from kontur_av.media import empty_picture, planes
from pipelines.media.marking import age_words, mark_stale


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
