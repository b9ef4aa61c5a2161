"""The dictionary: mistakes are refused with one line, and others read our telemetry by its XTCE."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from pus_ends import S, oven_table

from kontur_av.errors import ConfigError
from telepresence.tmtc.pus.dictionary_file import (
    built_in_dictionary,
    dictionary_from_table,
    load_dictionary,
)
from telepresence.tmtc.pus.head import destination_of
from telepresence.tmtc.pus.packets import Telecommand, pack_packet

Spoil = Callable[[dict[str, Any]], Any]


@pytest.mark.parametrize(
    ("spoil", "line"),
    [
        (lambda t: t.clear(), "oven needs apid"),
        (lambda t: t.update(apid=0x101), "oven.apid is 257: choose one from 1 to 2046 that is not"),
        (lambda t: t.update(end="moon"), "oven.end is 'moon': choose one of space, ground"),
        (lambda t: t.update(evnet={}), "unknown field oven.evnet: the nearest one is oven.event"),
        (
            lambda t: t["parameter"]["lit"].update(type="boolean"),
            "oven.parameter.lit.type is 'boolean': choose one of u8,",
        ),
        (
            lambda t: t["parameter"]["lit"].update(number=2),
            "oven.parameter.lit.number is 2, as that of door: give each its own",
        ),
        (
            lambda t: t["parameter"]["lit"].update(scale="x"),
            "oven.parameter.lit: scale must be a number, not 'x'",
        ),
        (
            lambda t: t["parameter"]["lit"].update(unti="V"),
            "oven.parameter.lit: unknown field unti: the nearest one is unit",
        ),
        (
            lambda t: t["structure"]["light"].update(parameters=["lid"]),
            "oven.structure.light.parameters: parameter 'lid' is unknown: the nearest one is lit",
        ),
        (
            lambda t: t["structure"]["light"].update(parameters=["depth"] * 59),
            "oven.structure.light.parameters take 237 octets",
        ),
        (
            lambda t: t["structure"]["light"].update(interval_s=0),
            "oven.structure.light.interval_s is 0.0: choose 0.1 to 3600",
        ),
        (
            lambda t: t["event"]["cooled"].update(severity="fatal"),
            "oven.event.cooled.severity is 'fatal': choose one of info, low, medium, high",
        ),
        (
            lambda t: t["monitor"]["heat"].update(above="hot"),
            "oven.monitor.heat: event 'hot' is unknown: the nearest one is too_hot",
        ),
        (lambda t: t["monitor"]["heat"].update(low=1.0), "a limit and its event 'below' need"),
        (
            lambda t: t["monitor"]["heat"].update(low=220.5, below="cooled"),
            "oven.monitor.heat.low is 220.5: it must not be above high",
        ),
        (lambda t: t["monitor"]["heat"].update(repeat=256), "heat.repeat is 256: choose 1 to 255"),
        (lambda t: t["monitor"]["heat"].update(repeat=0), "heat.repeat is 0: choose 1 to 255"),
        (lambda t: t["monitor"]["heat"].update(parameter="door"), "is 'door': choose a number"),
        (lambda t: t["monitor"]["heat"].update(back="hot"), "event 'hot' is unknown"),
        (lambda t: t["monitor"]["heat"].update(above=""), "a limit and its event 'above' need"),
        (
            lambda t: (t["monitor"]["heat"].pop("high"), t["monitor"]["heat"].pop("above")),
            "oven.monitor.heat has no limit: give low or high",
        ),
        (lambda t: t["action"][0].update(event="hot"), "event 'hot' is unknown"),
        (lambda t: t["action"][0].update(function="fan"), "function 'fan' is unknown"),
        (
            lambda t: t["action"].append(5),
            "must be tables [[oven.action]] with event, function, on",
        ),
        (lambda t: t["action"][0].update(evnet=1), "oven.action"),
        (lambda t: t.update(action={}), "oven.action must be tables [[oven.action]]"),
        (lambda t: t.update(event=[]), "oven.event must be tables [oven.event.NAME]"),
        (lambda t: t["event"].update(hot=5), "oven.event.hot must be a table [oven.event.hot]"),
        (lambda t: t["event"].update({"a-b": {}}), "give it a name of letters"),
        (lambda t: t["event"].update({"ä": {}}), "give it a name of letters"),
        (lambda t: t["event"]["cooled"].update(name="c"), "leave the field out"),
        (lambda t: t.update(text=5), "oven needs apid, a whole number"),
        (lambda t: t.update(apid=True), "oven needs apid, a whole number"),
        (lambda t: t.update(apid=0), "oven.apid is 0: choose one from 1 to 2046"),
        (lambda t: t.update(apid=2047), "not from 256 to 271"),
        (lambda t: t["parameter"]["lit"].update(number=256), "number is 256: choose 1 to 255"),
        (
            lambda t: t["parameter"]["lit"].update(type="text", size=65),
            "oven.parameter.lit.size is 65: choose 1 to 64",
        ),
        (lambda t: t["parameter"]["lit"].update(type="text"), "size is 0: choose 1 to 64"),
        (lambda t: t["parameter"]["lit"].update(size=1), "size is 1: only a text has one"),
        (lambda t: t["parameter"]["lit"].update(choices=["a"]), "choices need each other"),
        (lambda t: t["parameter"]["door"].update(choices=[]), "choices need each other"),
        (
            lambda t: t["parameter"]["door"].update(choices=[str(n) for n in range(257)]),
            "the type choice and 1 to 256 choices",
        ),
        (lambda t: t["parameter"]["target"].update(scale=0), "integers may have one above 0"),
        (lambda t: t["parameter"]["temperature"].update(scale=2), "scale is 2.0: integers may"),
        (
            lambda t: t["parameter"]["target"].update(low=251),
            "oven.parameter.target.low is 251.0: it must not be above high",
        ),
        (lambda t: t["structure"]["light"].update(parameters=[]), "take 1 octets: name some"),
        (lambda t: t["structure"]["light"].update(interval_s=3600.5), "choose 0.1 to 3600"),
        (
            lambda t: t["event"]["cooled"].update(arguments=["depth"] * 59),
            "oven.event.cooled.arguments are too long for a packet",
        ),
        (
            lambda t: t["function"]["off"].update(arguments=["depth"] * 61),
            "oven.function.off.arguments are too long for a packet",
        ),
        (
            lambda t: t["action"][0].update(function="heat"),
            "oven.action.too_hot.function is 'heat': choose one without arguments",
        ),
    ],
)
def test_a_mistake_is_refused_with_one_line(spoil: Spoil, line: str) -> None:
    table = oven_table()
    spoil(table["oven"])
    with pytest.raises(ConfigError) as caught:
        dictionary_from_table(table)
    assert line in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_is_on_a_limit_is_taken() -> None:
    table = oven_table()
    oven = table["oven"]
    oven["monitor"]["heat"].update(low=220.0, below="cooled", repeat=255)
    oven["parameter"]["door"]["choices"] = [str(number) for number in range(256)]
    oven["parameter"]["target"].update(low=250)
    oven["parameter"]["note"] = {"number": 255, "type": "text", "size": 64}
    oven["structure"]["light"].update(parameters=["depth"] * 58 + ["lit"] * 2, interval_s=0.1)
    oven["structure"]["rare"] = {"number": 3, "parameters": ["lit"], "interval_s": 3600}
    oven["event"]["cooled"]["arguments"] = ["depth"] * 58 + ["lit"] * 2
    oven["function"]["many"] = {"number": 3, "arguments": ["depth"] * 60 + ["lit"] * 2}
    for apid in (1, 0xFF, 0x110, 0x7FE):
        oven["apid"] = apid
        (application,) = dictionary_from_table(table).applications
    (monitor,) = application.monitors
    assert (monitor.low, monitor.high, monitor.repeat) == (220.0, 220.0, 255)
    assert application.structure("rare").interval_ns == 3600 * S
    assert application.function("many").number == 3
    with pytest.raises(KeyError):
        application.function("few")


def test_applications_have_names_and_apids_of_their_own() -> None:
    one, other = oven_table()["oven"], oven_table()["oven"]
    with pytest.raises(ConfigError, match=r"stove.apid is 512, as that of oven: give each its own"):
        dictionary_from_table({"oven": one, "stove": other})
    with pytest.raises(ConfigError, match="there is no application"):
        dictionary_from_table({})
    with pytest.raises(ConfigError, match=r"oven is 5: it must be a table \[oven\] with an apid"):
        dictionary_from_table({"oven": 5})
    with pytest.raises(ConfigError, match=r"'lit' is unknown: define \[bare.parameter\]"):
        dictionary_from_table(
            {
                "bare": {
                    "apid": 1,
                    "event": {"e": {"number": 1, "severity": "low", "arguments": ["lit"]}},
                }
            }
        )
    dictionary = dictionary_from_table({"oven": one, "stove": dict(other, apid=513)})
    assert [dictionary.by_apid[apid].name for apid in (512, 513)] == ["oven", "stove"]


def test_a_file_is_named_in_what_it_is_refused_for(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text("[oven]\napid = 1\n[oven.parameter.x]\nnumber = 0\ntype = 'u8'\n")
    with pytest.raises(ConfigError, match=r"mine.toml: oven.parameter.x.number is 0: choose"):
        load_dictionary(path)


def test_the_built_in_dictionary_keeps_clear_of_the_links_other_packets() -> None:
    applications = built_in_dictionary().applications
    assert {"joystick", "robot", "space_gateway", "ground_gateway"} <= {
        one.name for one in applications
    }
    assert all(one.apid >= 0x120 for one in applications)


def test_a_telecommand_goes_to_its_application_however_long_it_is() -> None:
    command = Telecommand(apid=0x200, count=1, service=8, subtype=1, data=bytes(range(1, 21)))
    assert destination_of(pack_packet(command)) == 0
