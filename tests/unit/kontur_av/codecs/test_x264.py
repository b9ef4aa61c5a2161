"""libx264 by ctypes beside PyAV's encoder of the same library."""

import pytest
from coding_loop import FPS, blocks, encode, keys, moving, octets

from kontur_av.codecs import x264
from kontur_av.codecs.coding import Coding
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
    assert x264.found.__wrapped__() is None
