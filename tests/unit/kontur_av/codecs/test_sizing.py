"""The coded size grows while a picture stands, and shrinks where it moves; changes are rare.

Cuts are detected by an unusual change, and pictures are small while cuts come fast.
"""

from itertools import pairwise
from typing import NamedTuple

import cv2
import numpy as np
import pytest
from coding_loop import SHARE_OCTETS, decode, encode, enlarged, keys, octets
from common import psnr_db

from kontur_av.codecs.coding import Coding
from kontur_av.codecs.sizing import CALM, RARE, Cuts, SizeChoice
from kontur_av.media import empty_picture, planes

AREAS = (320 * 240, 384 * 288, 480 * 360, 640 * 480)
USUAL, FULL = 1, 3


class Film:
    """Passes pictures to a choice, and keeps the indices that it returned."""

    def __init__(self):
        self.choice = SizeChoice(AREAS, usual=USUAL, rate_hz=30)
        self.indices, self._number = [], 0

    def show(self, pictures, content, *, moving=0.0, anew=False, shares=1.0):
        """Let a share `moving` of the cells change with each picture."""
        for count in range(pictures):
            self._number += 1
            thumbnail = np.full((30, 40), 100, np.uint8)
            thumbnail.reshape(-1)[: round(moving * 1200)] += 40 * (self._number % 2)
            index = self.choice.handle_picture(thumbnail, anew=anew and count == 0)
            self.indices.append(index)
            loss = content.scaling[index] if self.choice.wants_scaling_loss else None
            self.choice.handle_unit(content.quantiser[index], shares, content.coding, loss)
        return self.indices[-1] if self.indices else None


class Content(NamedTuple):
    """What x264 makes of pictures in each size: mean quantisers, and mean squared errors."""

    quantiser: tuple[float, ...]
    coding: float
    scaling: tuple[float, ...]


#: The task board at rest, which has fine print.
BOARD = Content((25, 28, 31, 36), 6, (23, 15, 8, 0))
#: A man before a bookshelf at rest: coding still loses more than scaling.
SHELF = Content((26, 29, 32, 37), 14, (9, 6, 2, 0))
CLEAR_SHELF = SHELF._replace(coding=3)
#: A talking head on a train.
FOOTAGE = Content((34, 37, 40, 46), 20, (0.6, 0.3, 0.2, 0))


@pytest.mark.parametrize(
    ("moved", "earliest", "latest"),
    # From the start at once; one that comes to rest after some seconds.
    [(0, 15, 30), (60, 90, 200)],
)
def test_a_picture_that_stands_grows_to_its_full_size(moved, earliest, latest):
    film = Film()
    film.show(moved, BOARD, moving=0.3)
    film.show(500, BOARD, moving=0.03)
    grown = film.indices.index(FULL)
    assert earliest < grown - moved < latest
    assert set(film.indices[:grown]) == {USUAL} and set(film.indices[grown:]) == {FULL}


COARSE = BOARD._replace(quantiser=tuple(step + 10 for step in BOARD.quantiser))
NOISY = BOARD._replace(quantiser=(29, 32, 37, 44))


@pytest.mark.parametrize(
    ("content", "pictures", "size"),
    # A size between is not taken early; what grew stays; coding may lose more than scaling.
    [(COARSE, 60, USUAL), (NOISY, 900, FULL), (SHELF, 900, USUAL), (CLEAR_SHELF, 900, FULL)],
)
def test_a_picture_that_stands_grows_once_if_scaling_loses_more_than_coding(
    content, pictures, size
):
    film = Film()
    assert film.show(pictures, content) == size
    assert film.choice.changes == (size == FULL)


def test_motion_a_cut_and_a_late_picture_end_the_large_size_at_once():
    for ending in ({"moving": 0.5}, {"anew": True}, {"shares": 3.0}):
        film = Film()
        assert film.show(300, BOARD) == FULL
        assert film.show(3, BOARD, **ending) == USUAL
        assert film.choice.changes == 2


def test_footage_in_motion_is_coded_smaller_and_a_short_one_is_not():
    film = Film()
    assert film.show(120, FOOTAGE, moving=0.2) == USUAL
    assert film.show(60, BOARD) == USUAL
    assert film.show(400, FOOTAGE, moving=0.2) == 0
    assert film.choice.changes == 1


def test_growth_in_vain_is_tried_ever_less_often_and_not_at_once_after_a_cut():
    film = Film()
    film.show(400, BOARD)
    for size in (FULL, USUAL):
        film.show(1, BOARD, anew=True)
        assert film.show(30, BOARD) == size
    film = Film()
    grown = []
    for _ in range(4):
        since = len(film.indices)
        while film.show(1, BOARD) != FULL:
            pass
        grown.append(len(film.indices) - since)
        film.show(10, BOARD, moving=0.5)
    assert all(later > 1.7 * sooner for sooner, later in pairwise(grown))


def still_of(count, *, grey=False):
    """Return a picture that stands, full of rings or grey, several times."""
    still = empty_picture(640, 480)
    still[:] = 128
    for number in range(0 if grey else 24):
        at = 20 + 150 * (number % 4), 60 + 70 * (number // 4)
        cv2.circle(planes(still)[0], at, 18, 30 + 8 * number, 3, cv2.LINE_AA)
    return [still] * count


def test_a_fast_refresh_takes_a_smaller_size_and_a_slow_one_the_usual_size_again():
    codings = {80: Coding(refresh_s=20.0)}
    units = encode(still_of(81, grey=True), refresh_s=1.0, codings=codings)
    sizes = [(one.width, one.height) for one in decode(units).values()]
    assert sizes[0] == (320, 240) and sizes[80] == (384, 288)
    assert set(sizes[:80]) <= {(320, 240), (384, 288)}


def test_a_still_picture_becomes_sharp_with_one_key_picture():
    originals = still_of(120)
    units = encode(originals, refresh_s=20)
    shown = decode(units)
    widths = [picture.width for picture in shown.values()]
    grown = widths.index(640)
    assert set(widths[:grown]) == {384} and set(widths[grown:]) == {640}
    assert keys(units) == [0, grown]
    before_db, after_db = (
        psnr_db(planes(enlarged(shown[at]))[0], planes(originals[0])[0]) for at in (grown - 1, 119)
    )
    assert after_db > before_db + 2
    assert octets(units)[1:].max() < 3.5 * SHARE_OCTETS


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


def test_constant_change_is_no_cut_and_repeatedly_requested_key_pictures_are_small():
    cuts = Cuts()
    asked = {150, 150 + RARE + 1, 150 + RARE + 31}
    restless = [
        cuts.handle_picture(view, key=n in asked) for n, view in enumerate(views(150 + RARE + 90))
    ]
    assert restless.index(True) == 150 + RARE + 31
    assert all(restless[restless.index(True) :])
    cuts = Cuts()
    assert not any(cuts.handle_picture(view) for view in views(300, change=18.0))
    assert cuts.found == 0


def test_footage_full_of_cuts_is_coded_small_and_they_are_on_time(pictures):
    units = encode(pictures("bikes.mp4", 250), refresh_s=20)
    sizes = [(one.width, one.height) for one in decode(units).values()]
    small = sizes.index((256, 192))
    assert set(sizes[:small]) == {(384, 288)} and set(sizes[small:]) == {(256, 192)}
    assert octets(units)[1:small].max() > 1.8 * SHARE_OCTETS
    assert octets(units)[small:].max() < 1.25 * SHARE_OCTETS
