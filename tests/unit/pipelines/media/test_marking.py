"""The mark on stale pictures: red on the edge, and the age in words."""

import numpy as np
import pytest

from kontur_av.clock import NS_PER_MS as MS
from kontur_av.media import CaptureStamp, VideoFrame, empty_picture, planes
from kontur_av.sources.stereo import StereoPair
from pipelines.media.marking import age_words, mark_halves, mark_stale


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


@pytest.mark.parametrize("old", ["left", "right"])
def test_only_the_old_half_of_a_merged_picture_is_marked(old):
    picture = grey(640, 480)
    frame = VideoFrame(picture, CaptureStamp(0, 0, old))
    stale = {"left_stale": old == "left", "right_stale": old == "right"}
    mark_halves(picture, StereoPair(frame, frame, frame.stamp, **stale), 1_300 * MS)
    halves = [
        {"left": plane[:, : plane.shape[1] // 2], "right": plane[:, plane.shape[1] // 2 :]}
        for plane in planes(picture)
    ]
    fresh = "left" if old == "right" else "right"
    assert all((half[fresh] == 128).all() for half in halves)
    assert [half[old][-1, 0] for half in halves] == [81, 90, 240]
    assert np.count_nonzero(halves[0][old][:48] == 235) > 100, "the words"


def test_an_age_is_formatted_for_people():
    ages = {0: "0 ms", 340: "340 ms", 1_300: "1.3 s", 75_000: "75 s", -1_000: "age unknown"}
    assert {age_ms: age_words(age_ms * MS) for age_ms in ages} == ages
    assert age_words(None) == "age unknown"
