"""The table of a user's component: what derives from it, and what is refused in one line."""

from dataclasses import replace

import pytest
from battery import Battery

from kontur_av.errors import ConfigError
from telepresence.tmtc.pus.dictionary import Dictionary
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary
from telepresence.tmtc.pus.packets import MAX_REPORT_OCTETS
from telepresence.tmtc.telemetry_source import (
    Component,
    TelemetryEvent,
    TelemetryFunction,
    TelemetryParameter,
    TelemetrySource,
    application_of,
    load_components,
    with_components,
)

VOLTAGE, TARGET, LIMIT, CELL = Battery.parameters


class Many(TelemetrySource):
    """More parameters than a packet has room for."""

    name = "many"
    parameters = tuple(
        TelemetryParameter(name=f"p{at}", type="text", size=40, period_s=60.0) for at in range(14)
    )


def made(**fields):
    return type("Other", (Battery,), fields)()


def test_reports_derive_from_periods_and_split_where_a_packet_is_full():
    table = application_of(Battery(), 0x140)
    assert [(one.interval_s, one.parameters) for one in table.structures] == [
        (1.0, ("voltage", "limit"))
    ]
    table = application_of(Many(), 0x140)
    assert [name for one in table.structures for name in one.parameters] == [
        one.name for one in Many.parameters
    ]
    for report in table.structures:
        assert 1 + sum(one.octets for one in table.named(report.parameters)) <= MAX_REPORT_OCTETS
    assert len(table.structures) == 3


@pytest.mark.parametrize(
    ("fields", "line"),
    [
        ({"name": ""}, "the component has no name: give it one"),
        ({"name": "a battery"}, "give it a name of letters"),
        ({"name": "robot"}, "another application has this name"),
        ({"parameters": (replace(VOLTAGE, type="f64"), TARGET, CELL)}, "type is 'f64'"),
        ({"parameters": (replace(VOLTAGE, low=20.0), TARGET, CELL)}, "must not be above high"),
        ({"parameters": (replace(VOLTAGE, low=None), TARGET, CELL)}, "need each other"),
        ({"parameters": (replace(VOLTAGE, below="lwo"), TARGET, CELL)}, "nearest one is low"),
        ({"parameters": (replace(VOLTAGE, period_s=0.01), TARGET, CELL)}, "choose 0.1 to 3600"),
        ({"parameters": (VOLTAGE, TARGET, TARGET, CELL)}, "give each a name of its own"),
        ({"parameters": VOLTAGE}, "cannot be a component"),
        ({"parameters": (replace(VOLTAGE, low="11"), TARGET, CELL)}, "cannot be a component"),
        ({"parameters": tuple(replace(one, period_s=0.1) for one in Battery.parameters)}, "bit/s"),
        ({"events": (TelemetryEvent(name="low", severity="bad"),)}, "severity is 'bad'"),
        ({"functions": (TelemetryFunction(name="f", arguments=("amps",)),)}, "'amps' is unknown"),
    ],
)
def test_what_cannot_be_is_refused_by_one_line(fields, line, monkeypatch):
    monkeypatch.setattr(
        "telepresence.tmtc.telemetry_source.load_telemetry", lambda _: made(**fields)
    )
    with pytest.raises(ConfigError) as caught:
        load_components(["some:Other"], built_in_dictionary())
    assert line in str(caught.value) and "\n" not in str(caught.value)


def test_what_a_spec_names_must_be_a_component():
    known = built_in_dictionary()
    with pytest.raises(ConfigError, match="inherit from"):
        load_components(["collections:OrderedDict"], known)
    with pytest.raises(ConfigError, match="no class 'Stove'"):
        load_components(["battery:Stove"], known)
    with pytest.raises(ConfigError, match="at most 8"):
        load_components(["battery:Battery"] * 9, known)
    with pytest.raises(ConfigError, match="another application has this name"):
        load_components(["battery:Battery"] * 2, known)
    (found,) = load_components(["battery:Battery"], known)
    assert found.spec == "battery:Battery"
    names = [one.name for one in with_components(known, [found]).applications]
    assert names == [*(one.name for one in known.applications), "battery"]


def test_a_dictionary_has_each_name_once():
    table = application_of(Battery(), 0x140)
    two = [Component("a", table), Component("b", replace(table, apid=0x141))]
    with pytest.raises(ConfigError, match="another application has this name"):
        with_components(Dictionary(applications=()), two)
