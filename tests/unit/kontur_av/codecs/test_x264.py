"""libx264 by ctypes beside PyAV's encoder of the same library."""

import numpy as np
import pytest
from coding_loop import FPS, blocks, decode, encode, keys, moving, octets

from kontur_av.codecs import x264
from kontur_av.codecs.coding import Coding
from kontur_av.codecs.decoder import VideoDecoder
from kontur_av.codecs.region import Region

needed = pytest.mark.skipif(
    x264.found() is None, reason="this machine has no libx264 of a known build"
)


@needed
@pytest.mark.parametrize("cap_bps", [50_000, 512_000])
def test_it_makes_the_access_units_of_pyav_octet_for_octet(monkeypatch, cap_bps):
    options = {
        "cap_bps": cap_bps,
        "keyframes": (40,),
        "refresh_s": 0.5,
        "codings": {20: Coding(rate_hz=20.0)},
        "regions": True,
        "region": Region(200, 100, 96, 96),
    }
    own = [unit.data for unit in encode(moving(60, 640, 480), **options)]
    monkeypatch.setattr(x264, "found", lambda: None)
    assert own == [unit.data for unit in encode(moving(60, 640, 480), **options)]


@pytest.mark.parametrize("itself", [pytest.param(True, marks=needed), False])
def test_a_new_cap_costs_a_key_picture_only_without_the_library(monkeypatch, itself):
    if not itself:
        monkeypatch.setattr(x264, "found", lambda: None)
    codings = {40: Coding(cap_bps=50_000), 80: Coding(cap_bps=85_000)}
    units = encode(blocks(120), codings=codings, refresh_s=60.0)
    assert keys(units) == ([0] if itself else [0, 40, 80])
    before, lower, after = (octets(units)[at : at + 30].mean() for at in (10, 50, 90))
    assert lower <= 1.1 * 50_000 / FPS / 8 < before and after > 1.1 * lower


def test_a_library_of_another_build_is_not_taken(monkeypatch):
    monkeypatch.setattr(x264, "carried_by_pyav", lambda name: None)
    monkeypatch.setattr(x264, "find_library", lambda name: "libx264.so.999")
    assert x264.looked_for.__wrapped__() == (None, "libx264 999 is of an unknown build")


@needed
@pytest.mark.parametrize("lost", [{40}, {37, 38}, {29, 30, 31}])
def test_after_a_loss_pictures_refer_to_those_before_it(lost):
    answer, size = 44, (384, 288)
    coding = Coding(lost=answer - min(lost))
    units = encode(blocks(80, *size), codings={answer: coding}, refresh_s=60.0)
    assert keys(units) == [0] and [n for n, unit in enumerate(units) if unit.heals] == [answer]
    assert len(units[answer].data) < 2 * octets(units)[20:].mean()
    whole, decoder = decode(units), VideoDecoder()
    broken = decode(units, decoder=decoder, lost=lost)
    wrong = [
        n for n, one in broken.items() if not np.array_equal(one.to_i420(), whole[n].to_i420())
    ]
    # Exact from the answer on, and no picture comes late.
    assert wrong == list(range(max(lost) + 1, answer))
    assert set(broken) == set(range(80)) - lost and not decoder.counts.decoder_restarts


@pytest.mark.parametrize(
    ("lost", "key", "refresh_s", "itself"),
    [
        pytest.param(15, False, 60.0, True, marks=needed),
        (16, True, 60.0, True),  # it is no longer in the decoder
        pytest.param(9, False, 60.0, True, marks=needed),
        (12, True, 60.0, True),  # the key picture is lost, too
        (3, True, 2.0, True),
        (3, True, 60.0, False),
    ],
)
def test_where_it_cannot_refer_to_them_a_key_picture_is_coded(
    monkeypatch, lost, key, refresh_s, itself
):
    if not itself:
        monkeypatch.setattr(x264, "found", lambda: None)
    first_key = () if lost > 12 else (20,)
    at = 30 if first_key else 40
    codings = {at: Coding(lost=lost)} | {n: Coding(keyframe=True) for n in first_key}
    units = encode(blocks(50), codings=codings, refresh_s=refresh_s)
    assert keys(units) == [0, *first_key, *[at] * key]
    assert units[at].heals is not key
