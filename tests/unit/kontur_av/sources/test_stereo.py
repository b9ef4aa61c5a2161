"""Stereo: merged exactly, paired by capture time, and working with one camera."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kontur_av.errors import ConfigError
from kontur_av.media import CaptureStamp, VideoFrame, empty_picture, planes
from kontur_av.sources.stereo import StereoPairer, merge

PERIOD_NS = 33_333_333
PICTURE = np.zeros((24, 16), np.uint8)


def noise(seed, width=64, height=48):
    return np.random.default_rng(seed).integers(0, 256, (height * 3 // 2, width), np.uint8)


def frame(capture_ns, source="left"):
    return VideoFrame(PICTURE, CaptureStamp(capture_ns, 0, source))


@given(st.floats(0, 1))
def test_each_pixel_comes_from_its_side(seam):
    left, right, into = noise(1), noise(2), empty_picture(64, 48)
    merge(left, right, into, seam)
    column = int(64 * seam) // 2 * 2
    for index, (got, a, b) in enumerate(
        zip(planes(into), planes(left), planes(right), strict=True)
    ):
        cut = column // 2 if index else column
        assert np.array_equal(got[:, :cut], a[:, :cut])
        assert np.array_equal(got[:, cut:], b[:, cut:])


def test_a_camera_that_never_came_is_black():
    left, into = noise(1), empty_picture(64, 48)
    merge(left, None, into)
    luma, u, _ = planes(into)
    assert np.array_equal(luma[:, :32], planes(left)[0][:, :32])
    assert (luma[:, 32:] == 16).all()
    assert (u[:, 16:] == 128).all()


def test_sizes_and_seam_are_refused():
    with pytest.raises(ConfigError, match=r"right camera gives 32x48.*64x48"):
        merge(noise(1), noise(2, 32), empty_picture(64, 48))
    with pytest.raises(ConfigError, match="seam"):
        merge(noise(1), noise(2), empty_picture(64, 48), 1.2)


def test_pairs_by_capture_time_and_stamps_with_the_older():
    pairer = StereoPairer(period_ns=PERIOD_NS)
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
    pairer = StereoPairer(period_ns=PERIOD_NS, stale_after_ns=100_000_000)
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


def test_one_camera_alone_is_shown_after_a_while():
    pairer = StereoPairer(period_ns=PERIOD_NS, stale_after_ns=100_000_000)
    shown = []
    for k in range(6):
        pairer.handle_left(frame(k * PERIOD_NS), k * PERIOD_NS)
        if pairer.poll_timeout() is not None:
            pairer.handle_timeout(pairer.poll_timeout())
        shown.append(pairer.next_event())
    assert shown[0] is None
    assert shown[-1].right is None
    assert shown[-1].right_stale


@given(st.lists(st.tuples(st.booleans(), st.integers(0, 60_000_000)), max_size=60))
def test_capture_times_only_rise_and_every_drop_is_counted(arrivals):
    pairer = StereoPairer(period_ns=PERIOD_NS)
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
