"""Stereo: merged exactly, paired by capture time, and working with one camera."""

from itertools import pairwise

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kontur_av.errors import ConfigError
from kontur_av.media import CaptureStamp, VideoFrame, empty_picture, planes
from kontur_av.sources.stereo import PicturePairer, SeamFinder, merge

PERIOD_NS = 33_333_333
PICTURE = np.zeros((24, 16), np.uint8)


def noise(seed, width=64, height=48):
    return np.random.default_rng(seed).integers(0, 256, (height * 3 // 2, width), np.uint8)


def frame(capture_ns, source="left"):
    return VideoFrame(PICTURE, CaptureStamp(capture_ns, 0, source))


@given(st.floats(0, 1))
def test_each_pixel_comes_from_its_side_and_a_missing_camera_is_black(seam):
    left, right, into = noise(1), noise(2), empty_picture(64, 48)
    column = int(64 * seam) // 2 * 2
    black = empty_picture(64, 48)
    planes(black)[0][:] = 16
    for plane in planes(black)[1:]:
        plane[:] = 128
    for other in (right, None):
        merge(left, other, into, seam)
        sides = zip(*map(planes, (into, left, black if other is None else other)), strict=True)
        for index, (got, a, b) in enumerate(sides):
            cut = column // 2 if index else column
            assert np.array_equal(got[:, :cut], a[:, :cut])
            assert np.array_equal(got[:, cut:], b[:, cut:])
    with pytest.raises(ConfigError, match=r"right camera gives 32x48.*64x48"):
        merge(left, noise(2, 32), into)
    with pytest.raises(ConfigError, match="seam"):
        merge(left, right, into, 1.2)


def test_pairs_by_capture_time_and_stamps_with_the_older():
    pairer = PicturePairer(period_ns=PERIOD_NS)
    for k in range(10):
        now_ns = k * PERIOD_NS
        pairer.handle_right(frame(now_ns + 3_000_000, "right"), now_ns + 4_000_000)
        assert pairer.next_event() is None
        pairer.handle_left(frame(now_ns), now_ns + 5_000_000)
        pair = pairer.next_event()
        assert (pair.stamp.capture_ns, pair.stamp.sequence) == (now_ns, k)
        assert not (pair.left_stale or pair.right_stale)
        assert pairer.poll_timeout() is None
    assert (pairer.paired, pairer.single, pairer.dropped) == (10, 0, 0)


def test_continues_with_the_last_picture_of_a_dead_camera():
    pairer = PicturePairer(period_ns=PERIOD_NS, stale_after_ns=100_000_000)
    pairer.handle_left(frame(0), 0)
    pairer.handle_right(frame(0, "right"), 0)
    assert pairer.next_event() is not None
    flags, captures = [], []
    for k in range(1, 8):
        now_ns = k * PERIOD_NS
        pairer.handle_right(frame(now_ns, "right"), now_ns)
        if pairer.poll_timeout() is not None:
            assert pairer.next_event() is None
            pairer.handle_timeout(pairer.poll_timeout())
        pair = pairer.next_event()
        flags.append(pair.left_stale)
        captures.append(pair.stamp.capture_ns)
        assert pair.left.stamp.capture_ns == 0
        assert not pair.right_stale
    assert captures == [k * PERIOD_NS for k in range(1, 8)]
    assert flags == [False, False, True, True, True, True, True]
    # A stale camera is not waited for. When it returns, its pictures are paired again.
    pairer.handle_left(frame(8 * PERIOD_NS), 8 * PERIOD_NS)
    pairer.handle_right(frame(8 * PERIOD_NS, "right"), 8 * PERIOD_NS)
    pair = pairer.next_event()
    assert not pair.left_stale
    assert pair.left.stamp.capture_ns == 8 * PERIOD_NS
    # One camera alone is shown after a while.
    pairer, shown = PicturePairer(period_ns=PERIOD_NS, stale_after_ns=100_000_000), []
    for k in range(6):
        pairer.handle_left(frame(k * PERIOD_NS), k * PERIOD_NS)
        if (due_ns := pairer.poll_timeout()) is not None:
            pairer.handle_timeout(due_ns)
        shown.append(pairer.next_event())
    assert shown[0] is None
    assert (shown[-1].right, shown[-1].right_stale) == (None, True)


@given(st.lists(st.tuples(st.booleans(), st.integers(0, 60_000_000)), max_size=60))
def test_capture_times_only_rise_and_every_drop_is_counted(arrivals):
    pairer = PicturePairer(period_ns=PERIOD_NS)
    now_ns, pairs, handed = 0, [], 0
    for is_left, gap_ns in arrivals:
        now_ns += gap_ns
        while (deadline_ns := pairer.poll_timeout()) is not None and deadline_ns <= now_ns:
            pairer.handle_timeout(deadline_ns)
            pairs.append(pairer.next_event())
        (pairer.handle_left if is_left else pairer.handle_right)(frame(now_ns), now_ns)
        handed += 1
        pairs.append(pairer.next_event())
    stamps = [pair.stamp for pair in pairs if pair is not None]
    assert [s.sequence for s in stamps] == list(range(len(stamps)))
    assert all(a.capture_ns < b.capture_ns for a, b in pairwise(stamps))
    waiting = pairer.poll_timeout() is not None
    assert 2 * pairer.paired + pairer.single + pairer.dropped + waiting == handed


WIDTH, HEIGHT = 640, 480
_GRAIN = np.random.default_rng(5).normal(110, 60, (60, 80)).astype(np.float32)
PLANE = np.clip(cv2.resize(_GRAIN, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC), 30, 200)
#: The right camera is a little brighter, and half a pixel off.
RIGHT_PLANE = 1.06 * np.roll(PLANE, 1, axis=1) * 0.5 + 1.06 * PLANE * 0.5


def pair(x, y, apart, radius=50):
    """A ball above the plane that the two cameras see `apart` pixels from each other."""
    pictures = []
    for plane, at in ((PLANE, x + apart // 2), (RIGHT_PLANE, x - apart // 2)):
        picture = empty_picture(WIDTH, HEIGHT)
        planes(picture)[0][:] = plane
        cv2.circle(planes(picture)[0], (at, y), radius, 235, cv2.FILLED)
        pictures.append(picture)
    return pictures


def balls(picture):
    """How many pixels of the ball a picture has."""
    return int(np.count_nonzero(planes(picture)[0] == 235))


def settled(finder, left, right):
    """The seam of two pictures that stay; it takes steps of two of forty blocks."""
    seams = [finder.handle_pictures(left, right) for _ in range(21)]
    assert all(abs(after - before) <= 2 / 40 + 1e-9 for before, after in pairwise(seams))
    assert seams[-1] == finder.handle_pictures(left, right)
    return seams[-1]


@given(
    st.lists(
        st.tuples(st.integers(100, 540), st.integers(60, 420), st.integers(110, 200)), max_size=6
    )
)
def test_what_stands_above_the_plane_is_whole_or_left_out(places):
    finder, into = SeamFinder(), empty_picture(WIDTH, HEIGHT)
    for place in places:
        left, right = pair(*place)
        merge(left, right, into, settled(finder, left, right))
        assert balls(into) in (0, balls(left), balls(right))


def test_the_seam_is_in_the_middle_while_nothing_crosses_it_and_returns_there():
    finder = SeamFinder()
    assert finder.handle_pictures(*pair(120, 240, 110)) == 0.5
    assert finder.handle_pictures(*pair(290, 240, 110)) != 0.5
    seams = [finder.handle_pictures(*pair(120, 240, 110)) for _ in range(20)]
    assert seams[-1] == 0.5
    # It keeps its side of a ball that trembles.
    finder = SeamFinder()
    seams = [finder.handle_pictures(*pair(320 + 6 * (k % 2), 240, 110)) for k in range(20)]
    assert len({seam < 0.5 for seam in seams}) == 1


def test_without_a_common_plane_of_two_pictures_it_is_in_the_middle():
    for missing in (0, 1):
        finder, both = SeamFinder(), pair(320, 240, 110)
        assert finder.handle_pictures(*both) != 0.5
        both[missing] = None
        assert finder.handle_pictures(*both) == 0.5
    left, right = pair(320, 240, 110)
    planes(right)[0][:] = planes(right)[0][::-1, ::-1].copy()
    assert SeamFinder().handle_pictures(left, right) == 0.5
