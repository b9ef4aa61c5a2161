"""A setup as TOML is read back as the same setup."""

import tomllib
from dataclasses import fields, replace

import pytest

from pipelines.session.setup.composition import Composition
from pipelines.session.setup.setup_file import BUILT_IN, setup_from_table
from pipelines.session.setup.setup_text import setup_toml

SETUPS = [
    *BUILT_IN.values(),
    replace(
        BUILT_IN["taskboard"],
        name='a "name" \\ with\ttabs',
        sources={"left": "pipe:/tmp/ü"},
        radio="geo",
        deadband="latency",
        hand="mediated",
        tasks=True,
        recorded_cameras="all",
        region="stylus",
        cameras=("stereo", "static", "bo th"),
        composed={"bo th": Composition(compose=("head", "static"), share=0.4)},
        region_points={"stereo": ((80.0, 60.0), (560.0, 66.5), (600.0, 420.0), (50.0, 410.0))},
        uplink_video=replace(
            BUILT_IN["taskboard"].uplink_video,
            coded=(320, 240),
            stale_after_ms=700.5,
            prefer="latency",
        ),
    ),
]


@pytest.mark.parametrize("setup", SETUPS, ids=lambda setup: setup.name[:10])
def test_it_is_read_back_as_it_was(setup):
    again = setup_from_table(tomllib.loads(setup_toml(setup)))
    for field in fields(setup):
        if field.name != "sources":
            assert getattr(again, field.name) == getattr(setup, field.name), field.name
    assert {name: again.source(name) for name in again.inputs} == {
        name: setup.source(name) for name in setup.inputs
    }
