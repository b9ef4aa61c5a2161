"""The region is where a person says, else around the tip, where that is known."""

from dataclasses import replace

import numpy as np
import pytest

from kontur_av.clock import NS_PER_MS
from kontur_av.codecs.region import Focus, Region
from kontur_av.errors import ConfigError
from kontur_av.media import Tip
from pipelines.media.following import focus_region
from pipelines.session.setup.setup_file import BUILT_IN
from telepresence.world.ground_views import camera_of

SETUP = replace(BUILT_IN["spacejustin"], region="stylus")
CORNERS = ((100, 100), (500, 100), (500, 380), (100, 380))
OWN = {"static": "v4l2:/dev/video0"}


def tip_at(x_m=0.0, y_m=0.0, **changes):
    tip = focus_region(replace(SETUP, **changes))
    tip.handle_tip(x_m, y_m, 0)
    return tip


def centre(region):
    return region.left + region.width / 2, region.top + region.height / 2


@pytest.mark.parametrize(("camera", "scene"), [("stereo", "left"), ("static", "static")])
def test_the_region_is_around_the_tip_where_the_world_draws_it(camera, scene):
    region = tip_at(0.04, -0.02).region(camera, 0)
    assert (region.width, region.height) == (96, 96)
    (drawn,) = camera_of(scene, 640, 480).project(np.array([(0.04, -0.02, 0.0)]))
    assert centre(region) == pytest.approx(drawn, abs=1)


def test_a_camera_of_the_users_own_is_calibrated_and_without_a_fresh_tip_there_is_no_region():
    # What the setup says of a camera wins over what the world knows.
    for sources in (OWN, {}):
        tip = tip_at(sources=sources, region_points={"static": CORNERS})
        assert centre(tip.region("static", 0)) == (300, 240)
    assert focus_region(SETUP).region("stereo", 0) is None
    tip = tip_at(sources=OWN)
    assert tip.region("stereo", 200 * NS_PER_MS) is not None
    assert tip.region("stereo", 201 * NS_PER_MS) is None
    assert tip.region("static", 0) is None
    assert tip.region(None, 0) is None
    # The halves of the stereo picture would no longer show the same place.
    tip = tip_at(sources={"right": "v4l2:/dev/video0"})
    assert tip.region("stereo", 0) is None
    assert tip.region("head", 0) is not None


def test_a_person_comes_before_a_driver_and_a_driver_before_what_is_known_of_the_camera():
    tip = tip_at(sources=OWN)
    tip.handle_tips({"static": Tip(0.5, 0.01), "stereo": Tip(1.5, 0.5)}, 0)
    assert tip.region("static", 600 * NS_PER_MS) == Region(272, 0, 96, 96)
    assert tip.region("static", 601 * NS_PER_MS) is None and tip.region("stereo", 0) is None
    tip.person = Focus.parse("0.25,0.5,0.375,0.375")
    assert tip.region("static", 0) == Region(160, 240, 240, 180) and tip.newest is tip.person


@pytest.mark.rule("6")
@pytest.mark.parametrize(
    ("wrong", "fix"),
    [
        ({"region": "tip"}, "region 'tip': take one of off, stylus"),
        ({"region": "off", "region_points": {"static": CORNERS}}, 'add region = "stylus"'),
        ({"region_points": {"wrist": CORNERS}}, "region_points of wrist: .* no such camera"),
        ({"region_points": {"static": CORNERS[:3]}}, "of static: 3 points: give the board's four"),
        ({"region_points": {"static": CORNERS[::-1]}}, "of static: .* must go clockwise"),
    ],
)
def test_a_region_that_cannot_work_is_refused(wrong, fix):
    with pytest.raises(ConfigError, match=fix):
        replace(SETUP, **wrong)
