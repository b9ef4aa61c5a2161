"""Figures and verdict of the passes of simulated sessions."""

from dataclasses import replace

import pytest

from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.virtual.campaign.figures import (
    faults,
    pass_figures,
)
from pipelines.virtual.simulate import simulate
from telepresence.haptics.loop import HapticLink

S = 1_000_000_000


@pytest.mark.parametrize("silent", [(-1, 2), (4, 99), (-1, 99)])
def test_a_force_that_begins_late_or_stops_for_good_is_stuck(silent, monkeypatch):
    send = HapticLink.poll_transmit

    def poll_transmit(link, now_ns):
        sample = send(link, now_ns)
        return None if silent[0] * S <= now_ns < silent[1] * S else sample

    monkeypatch.setattr(HapticLink, "poll_transmit", poll_transmit)
    setup = replace(BUILT_IN["spacejustin"], radio="clean")
    figures = pass_figures(simulate(setup, seconds=6.0, seed=1, media=False))
    assert "stuck" in faults(figures)
    longest_s = min(silent[1], 6) - max(silent[0], 0)
    assert figures.longest_pause_s["felt"] == pytest.approx(longest_s, abs=0.2)


def test_the_delay_of_a_far_orbit_does_not_count_as_lost_signal():
    setup = replace(BUILT_IN["spacejustin"], radio="geo")
    figures = pass_figures(simulate(setup, seconds=2.0, seed=1, media=False))
    assert figures.usable_s < 1.8
    assert faults(figures) == []
    assert faults(replace(figures, usable_s=figures.usable_s - 0.2)) == ["unusable"]
