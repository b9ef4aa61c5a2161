"""A camera of 60 Hz over the thin uplink: which pictures are coded, and how soon."""

from dataclasses import replace

import pytest

from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.virtual.simulate import simulate


def uplink(**changes):
    setup = BUILT_IN["spacejustin"]
    # Only the uplink is looked at, so nothing else is coded.
    setup = replace(setup, downlink_video=None, downlink_voice=None)
    setup = replace(setup, uplink_video=replace(setup.uplink_video, **changes))
    stream = simulate(setup, seconds=10, seed=1).streams["uplink_video"]
    assert stream.payload_bps_max_1s <= stream.cap_bps
    return stream


def test_small_pictures_of_a_fast_camera_are_sooner_and_fill_the_cap():
    usual = uplink()
    good = uplink(fps=60)
    soon = uplink(fps=60, prefer="latency")
    assert good.displayed_hz == pytest.approx(usual.displayed_hz, rel=0.1)
    assert soon.displayed_hz > 1.25 * usual.displayed_hz
    for stream in (good, soon):
        assert stream.payload_bps_mean > 0.75 * stream.cap_bps
    assert soon.latency_ms.p50 < usual.latency_ms.p50 - 7
    assert soon.latency_ms.p99 < usual.latency_ms.p99 - 7
