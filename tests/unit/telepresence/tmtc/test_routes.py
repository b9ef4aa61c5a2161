"""A file of routes is refused by one line with its fix."""

import pytest

from kontur_av.errors import ConfigError
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary
from telepresence.tmtc.routes import TelemetryRoute, read_routes, with_routes


@pytest.mark.parametrize(
    ("text", "fix"),
    [
        ('<Route from="robot" data="x" to="ground"/>', "<Route> here: write <Route .../> in"),
        (
            '<Routes><Route form="robot"/></Routes>',
            "unknown attribute form: the nearest",
        ),
        ('<Routes><Route from="robot" to="ground"/></Routes>', 'needs data="..."'),
        ('<Routes>\n<Route from="robot" data="x" to="a" period_s="1"/></Routes>', "line 2: period"),
        ("<!DOCTYPE a><Routes/>", "document type is not allowed"),
        ("<Routes>", "no well-formed XML"),
    ],
)
def test_a_file_says_what_is_wrong_in_it(text, fix):
    with pytest.raises(ConfigError, match=fix):
        read_routes(text.encode())


@pytest.mark.parametrize(
    ("route", "fix"),
    [
        ({"source": "robt", "data": ("x",), "to": "ground"}, "'robt' is unknown: choose one of"),
        ({"source": "robot", "data": ("z",), "to": "ground"}, "'z' is unknown: the nearest one is"),
        ({"source": "robot", "data": ("x",), "to": "moon"}, "'moon': choose one of ground, cooler"),
        ({"source": "robot", "data": ("x",), "to": "ground", "period_s": 0.1}, "longer period_s"),
    ],
)
def test_routes_are_checked_against_the_dictionary(route, fix):
    with pytest.raises(ConfigError, match=fix):
        with_routes(built_in_dictionary(), [TelemetryRoute(**route)], ["cooler"])
