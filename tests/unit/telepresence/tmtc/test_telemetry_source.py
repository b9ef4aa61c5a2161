"""The table of a user's component: what derives from it, and what is refused in one line."""

from dataclasses import replace

import pytest
from battery import Battery

from kontur_av.errors import ConfigError
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary
from telepresence.tmtc.pus.packets import MAX_REPORT_OCTETS
from telepresence.tmtc.telemetry_source import (
    TelemetryEvent,
    TelemetryFunction,
    TelemetryParameter,
    TelemetrySource,
    application_of,
    load_components,
    with_components,
)

VOLTAGE, TARGET, LIMIT, CELL = Battery.parameters


def made(**fields):
    return type("Other", (Battery,), fields)()


def table_of(**fields):
    """The table of a battery with other fields."""
    return application_of(made(**fields), 0x140)


def several(count, **fields):
    """A component of nothing but so many parameters."""
    names = (f"p{at}" for at in range(count))
    parameters = tuple(TelemetryParameter(name=name, **fields) for name in names)
    return {"parameters": parameters, "events": (), "functions": ()}


@pytest.fixture
def load(monkeypatch):
    """Load components that are the given objects."""

    def run(*sources):
        left = iter(sources)
        monkeypatch.setattr(
            "telepresence.tmtc.telemetry_source.load_telemetry", lambda _: next(left)
        )
        return load_components(["some:Other"] * len(sources), built_in_dictionary())

    return run


def test_reports_derive_from_periods_and_split_where_a_packet_is_full():
    assert [(one.interval_s, one.parameters) for one in table_of().structures] == [
        (1.0, ("voltage", "limit"))
    ]
    many = several(14, type="text", size=40, period_s=60.0)
    table = table_of(**many)
    names = [name for structure in table.structures for name in structure.parameters]
    assert names == [one.name for one in many["parameters"]]
    for report in table.structures:
        assert 1 + sum(one.octets for one in table.named(report.parameters)) <= MAX_REPORT_OCTETS
    assert len(table.structures) == 3
    # A report has its number and 234 octets of values.
    (report,) = table_of(**several(117, type="u16")).structures
    assert len(report.parameters) == 117


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
def test_what_cannot_be_is_refused_by_one_line(fields, line, load):
    with pytest.raises(ConfigError) as caught:
        load(made(**fields))
    assert line in str(caught.value) and "\n" not in str(caught.value)


def test_what_a_spec_names_must_be_a_component():
    known = built_in_dictionary()
    for specs, line in (
        (["collections:OrderedDict"], "inherit from"),
        (["battery:Stove"], "no class 'Stove'"),
        (["battery:Battery"] * 9, "at most 8"),
        (["battery:Battery"] * 2, "another application has this name"),
    ):
        with pytest.raises(ConfigError, match=line):
            load_components(specs, known)
    (found,) = load_components(["battery:Battery"], known)
    assert found.spec == "battery:Battery"
    names = [application.name for application in with_components(known, [found]).applications]
    assert names == [*(application.name for application in known.applications), "battery"]


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
    ("changes", "limits", "clear"),
    [
        ({"low": None, "below": ""}, (None, 14.4), (None, 13.68)),
        ({"high": None, "above": "", "low": -8.0}, (-8.0, None), (-7.6, None)),
        # A limit without an event belongs to the range, not to the monitor.
        ({"above": ""}, (11.1, None), (11.265, None)),
    ],
)
def test_a_value_with_one_limit_comes_back_by_a_twentieth_of_it(changes, limits, clear):
    (one,) = table_of(parameters=(replace(VOLTAGE, **changes),), functions=()).monitors
    assert (one.low, one.high) == limits
    assert (one.low_clear, one.high_clear) == pytest.approx(clear)


def test_periods_have_reports_of_their_own_and_none_is_reported():
    periods_s = (10.0, None, 2.0, 10.0)
    fields = several(4)
    fields["parameters"] = tuple(
        replace(one, period_s=period_s)
        for one, period_s in zip(fields["parameters"], periods_s, strict=True)
    )
    assert [
        (one.number, one.interval_s, one.parameters) for one in table_of(**fields).structures
    ] == [(1, 10.0, ("p0", "p3")), (2, 2.0, ("p2",))]
    assert TelemetryParameter(name="x").period_s == 10.0


def test_names_have_at_most_32_characters_and_apids_follow_each_other(load):
    table_of(name="a" * 32)
    with pytest.raises(ConfigError, match="at most 32"):
        table_of(name="b" * 33)
    found = load(*(made(name=f"c{at}", **several(0)) for at in range(8)))
    assert [one.application.apid for one in found] == list(range(0x140, 0x148))


def test_reports_of_all_components_take_1000_bits_a_second(load):
    # Each report has 22 octets beside its values.
    load(made(**several(103, type="u8", period_s=1.0)))
    with pytest.raises(ConfigError, match="take 1008 bit/s of 1000"):
        load(made(**several(104, type="u8", period_s=1.0)))


def test_a_component_that_does_nothing_says_so():
    idle = TelemetrySource()
    assert idle.read() == ({}, ())
    assert idle.call("recharge", {}) == "it does nothing"
    assert list(idle.handle_event(None)) == []
