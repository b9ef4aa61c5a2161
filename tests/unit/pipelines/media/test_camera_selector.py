"""Selector: the last command wins; an unknown camera changes nothing."""

import pytest

from kontur_av.errors import ConfigError, ProtocolError
from pipelines.media.camera_selector import Selector


def test_switches_and_counts():
    selector = Selector(["stereo", "static", "head"], "stereo")
    selection = selector.handle_select("head", 5)
    assert (selection.camera, selection.previous, selection.since_ns) == ("head", "stereo", 5)
    assert selection.changed
    again = selector.handle_select("head", 9)
    assert not again.changed
    assert again.since_ns == 5
    assert (selector.selected, selector.switches) == ("head", 1)


def test_unknown_camera_names_the_known():
    selector = Selector(["stereo", "static"], "static")
    with pytest.raises(ProtocolError, match="stereo, static"):
        selector.handle_select("hed", 1)
    assert (selector.selected, selector.refused, selector.switches) == ("static", 1, 0)
    with pytest.raises(ConfigError, match="stereo, static"):
        Selector(["stereo", "static"], "head")
