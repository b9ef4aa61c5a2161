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


def test_a_component_has_numbers_limits_and_defaults():
    table = application_of(Battery(), 0x140)
    assert (table.apid, table.end, table.fresh_s) == (0x140, "ground", 5.0)
    for items in (table.parameters, table.events, table.functions, table.structures):
        assert [one.number for one in items] == list(range(1, len(items) + 1))
    assert table.structures[0].name == "report_1"
    (voltage,) = table.monitors
    # After an event a value must come back by a twentieth of its range.
    assert (voltage.name, voltage.number, voltage.parameter) == ("voltage", 1, "voltage")
    assert (voltage.low, voltage.high, voltage.repeat) == (11.1, 14.4, 2)
    assert (voltage.low_clear, voltage.high_clear) == pytest.approx((11.265, 14.235))
    assert (voltage.below, voltage.above, voltage.back) == ("low", "high", "")


@pytest.mark.parametrize(
    ("changes", "low", "low_clear", "high", "high_clear"),
    [
        ({"low": None, "below": ""}, None, None, 14.4, 14.4 - 0.05 * 14.4),
        ({"high": None, "above": "", "low": -8.0}, -8.0, -8.0 + 0.05 * 8.0, None, None),
        # A limit without an event belongs to the range, not to the monitor.
        ({"above": ""}, 11.1, 11.1 + 0.05 * 3.3, None, None),
    ],
)
def test_a_value_with_one_limit_comes_back_by_a_twentieth_of_it(
    changes, low, low_clear, high, high_clear
):
    (one,) = application_of(
        made(parameters=(replace(VOLTAGE, **changes),), functions=()), 1
    ).monitors
    assert (one.low, one.high) == (low, high)
    assert (one.low_clear, one.high_clear) == pytest.approx((low_clear, high_clear))


def test_periods_have_reports_of_their_own_and_none_is_reported():
    parameters = tuple(
        TelemetryParameter(name=f"p{at}", period_s=period_s)
        for at, period_s in enumerate((10.0, None, 2.0, 10.0))
    )
    table = application_of(made(parameters=parameters, events=(), functions=()), 1)
    assert [(one.number, one.interval_s, one.parameters) for one in table.structures] == [
        (1, 10.0, ("p0", "p3")),
        (2, 2.0, ("p2",)),
    ]
    assert TelemetryParameter(name="x").period_s == 10.0
    # A report has its number and 234 octets of values.
    full = tuple(TelemetryParameter(name=f"p{at}", type="u16") for at in range(117))
    (report,) = application_of(made(parameters=full, events=(), functions=()), 1).structures
    assert len(report.parameters) == 117


def test_names_have_at_most_32_characters_and_apids_follow_each_other(monkeypatch):
    for name in ("a" * 32, "b" * 33):
        if len(name) <= 32:
            application_of(made(name=name), 1)
            continue
        with pytest.raises(ConfigError, match="at most 32"):
            application_of(made(name=name), 1)
    sources = iter([made(name=f"c{at}", parameters=(), events=(), functions=()) for at in range(8)])
    monkeypatch.setattr(
        "telepresence.tmtc.telemetry_source.load_telemetry", lambda _: next(sources)
    )
    found = load_components(["some:Other"] * 8, built_in_dictionary())
    assert [one.application.apid for one in found] == list(range(0x140, 0x148))


def test_reports_of_all_components_take_1000_bits_a_second(monkeypatch):
    # Each report has 22 octets beside its values.
    for octets, fits in ((103, True), (104, False)):
        one = TelemetryParameter(name="p", type="u8", period_s=1.0)
        parameters = tuple(replace(one, name=f"p{at}") for at in range(octets))
        source = made(parameters=parameters, events=(), functions=())
        monkeypatch.setattr(
            "telepresence.tmtc.telemetry_source.load_telemetry", lambda _, made=source: made
        )
        if fits:
            load_components(["some:Other"], built_in_dictionary())
            continue
        with pytest.raises(ConfigError, match="take 1008 bit/s of 1000"):
            load_components(["some:Other"], built_in_dictionary())


def test_a_component_that_does_nothing_says_so():
    idle = TelemetrySource()
    assert idle.read() == ({}, ())
    assert idle.call("recharge", {}) == "it does nothing"
    assert list(idle.handle_event(None)) == []
