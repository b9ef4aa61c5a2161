"""The dictionary: each mistake is refused with one line that names the field and what would fit."""

import pytest
from pus_ends import S, oven_table

from kontur_av.errors import ConfigError
from telepresence.tmtc.pus.dictionary_file import (
    built_in_dictionary,
    dictionary_from_table,
    load_dictionary,
)

LIT, PLUGINS, TARGET, HEAT = "parameter lit", "parameter door", "parameter target", "monitor heat"
LIGHT, COOLED, OFF, RULE = "structure light", "event cooled", "function off", "action 0"
MANY = ["depth"] * 58 + ["lit"] * 2


def table_at(table, where):
    """The table at `where`, a path of keys and indices."""
    for key in where.split():
        table = table[int(key) if key.isdigit() else key]
    return table


@pytest.mark.parametrize(
    ("where", "changes", "line"),
    [
        ("", {"apid": None}, "oven needs apid"),
        ("", {"apid": True}, "oven needs apid, a whole number"),
        ("", {"text": 5}, "oven needs apid, a whole number"),
        ("", {"apid": 0x101}, "oven.apid is 257: choose one from 1 to 2046 that is not"),
        ("", {"apid": 0}, "oven.apid is 0: choose one from 1 to 2046"),
        ("", {"apid": 2047}, "not from 256 to 271"),
        ("", {"end": "moon"}, "oven.end is 'moon': choose one of space, ground"),
        ("", {"evnet": {}}, "unknown field oven.evnet: the nearest one is oven.event"),
        ("", {"action": {}}, "oven.action must be tables [[oven.action]]"),
        ("", {"action": [5]}, "must be tables [[oven.action]] with event, function, on"),
        ("", {"event": []}, "oven.event must be tables [oven.event.NAME]"),
        ("event", {"hot": 5}, "oven.event.hot must be a table [oven.event.hot]"),
        ("event", {"a-b": {}}, "give it a name of letters"),
        ("event", {"ä": {}}, "give it a name of letters"),
        (LIT, {"type": "boolean"}, "oven.parameter.lit.type is 'boolean': choose one of u8,"),
        (LIT, {"number": 2}, "oven.parameter.lit.number is 2, as that of door: give each its own"),
        (LIT, {"number": 256}, "number is 256: choose 1 to 255"),
        (LIT, {"scale": "x"}, "oven.parameter.lit: scale must be a number, not 'x'"),
        (LIT, {"unti": "V"}, "oven.parameter.lit: unknown field unti: the nearest one is unit"),
        (LIT, {"type": "text", "size": 65}, "oven.parameter.lit.size is 65: choose 1 to 64"),
        (LIT, {"type": "text"}, "size is 0: choose 1 to 64"),
        (LIT, {"size": 1}, "size is 1: only a text has one"),
        (LIT, {"choices": ["a"]}, "choices need each other"),
        (PLUGINS, {"choices": []}, "choices need each other"),
        (PLUGINS, {"choices": list(map(str, range(257)))}, "the type choice and 1 to 256 choices"),
        (TARGET, {"scale": 0}, "integers may have one above 0"),
        (TARGET, {"low": 251}, "oven.parameter.target.low is 251.0: it must not be above high"),
        ("parameter temperature", {"scale": 2}, "scale is 2.0: integers may"),
        (LIGHT, {"parameters": ["lid"]}, "parameter 'lid' is unknown: the nearest one is lit"),
        (LIGHT, {"parameters": ["depth"] * 59}, "oven.structure.light.parameters take 237 octets"),
        (LIGHT, {"parameters": []}, "take 1 octets: name some"),
        (LIGHT, {"interval_s": 0}, "oven.structure.light.interval_s is 0.0: choose 0.1 to 3600"),
        (LIGHT, {"interval_s": 3600.5}, "choose 0.1 to 3600"),
        (COOLED, {"severity": "fatal"}, "is 'fatal': choose one of info, low, medium, high"),
        (COOLED, {"name": "c"}, "leave the field out"),
        (COOLED, {"arguments": ["depth"] * 59}, "cooled.arguments are too long for a packet"),
        (OFF, {"arguments": ["depth"] * 61}, "oven.function.off.arguments are too long for a pac"),
        (HEAT, {"above": "hot"}, "oven.monitor.heat: event 'hot' is unknown: the nearest one is"),
        (HEAT, {"back": "hot"}, "event 'hot' is unknown"),
        (HEAT, {"above": ""}, "a limit and its event 'above' need"),
        (HEAT, {"low": 1.0}, "a limit and its event 'below' need"),
        (HEAT, {"low": 220.5, "below": "cooled"}, "low is 220.5: it must not be above high"),
        (HEAT, {"high": None, "above": None}, "oven.monitor.heat has no limit: give low or high"),
        (HEAT, {"repeat": 256}, "heat.repeat is 256: choose 1 to 255"),
        (HEAT, {"repeat": 0}, "heat.repeat is 0: choose 1 to 255"),
        (HEAT, {"parameter": "door"}, "is 'door': choose a number"),
        (RULE, {"event": "hot"}, "event 'hot' is unknown"),
        (RULE, {"evnet": 1}, "oven.action"),
        (RULE, {"function": "fan"}, "function 'fan' is unknown"),
        (RULE, {"function": "heat"}, "oven.action.too_hot.function is 'heat': choose one without"),
    ],
)
def test_a_mistake_is_refused_with_one_line(where, changes, line):
    table = oven_table()
    place = table_at(table["oven"], where)
    for name, value in changes.items():
        if value is None:
            del place[name]
        else:
            place[name] = value
    with pytest.raises(ConfigError) as caught:
        dictionary_from_table(table)
    assert line in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_is_on_a_limit_is_taken():
    table = oven_table()
    oven = table["oven"]
    table_at(oven, HEAT).update(low=220.0, below="cooled", repeat=255)
    table_at(oven, PLUGINS)["choices"] = list(map(str, range(256)))
    table_at(oven, TARGET).update(low=250)
    table_at(oven, LIGHT).update(parameters=MANY, interval_s=0.1)
    table_at(oven, COOLED)["arguments"] = MANY
    oven["parameter"]["note"] = {"number": 255, "type": "text", "size": 64}
    oven["structure"]["rare"] = {"number": 3, "parameters": ["lit"], "interval_s": 3600}
    oven["function"]["many"] = {"number": 3, "arguments": ["depth"] * 2 + MANY}
    for apid in (1, 0xFF, 0x110, 0x7FE):
        oven["apid"] = apid
        (application,) = dictionary_from_table(table).applications
    (monitor,) = application.monitors
    assert (monitor.low, monitor.high, monitor.repeat) == (220.0, 220.0, 255)
    assert application.structure("rare").interval_ns == 3600 * S
    assert application.function("many").number == 3
    with pytest.raises(KeyError):
        application.function("few")


def test_applications_have_names_and_apids_of_their_own():
    one, other = oven_table()["oven"], oven_table()["oven"]
    event = {"number": 1, "severity": "low", "arguments": ["lit"]}
    for table, line in (
        ({"oven": one, "stove": other}, "stove.apid is 512, as that of oven: give each its own"),
        ({}, "there is no application"),
        ({"oven": 5}, r"oven is 5: it must be a table \[oven\] with an apid"),
        (
            {"bare": {"apid": 1, "event": {"e": event}}},
            r"'lit' is unknown: define \[bare.parameter\]",
        ),
    ):
        with pytest.raises(ConfigError, match=line):
            dictionary_from_table(table)
    dictionary = dictionary_from_table({"oven": one, "stove": dict(other, apid=513)})
    assert [dictionary.by_apid[apid].name for apid in (512, 513)] == ["oven", "stove"]


def test_a_file_is_named_in_what_it_is_refused_for(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text("[oven]\napid = 1\n[oven.parameter.x]\nnumber = 0\ntype = 'u8'\n")
    with pytest.raises(ConfigError, match=r"mine.toml: oven.parameter.x.number is 0: choose"):
        load_dictionary(path)


def test_the_built_in_dictionary_keeps_clear_of_the_links_other_packets():
    apids = {one.name: one.apid for one in built_in_dictionary().applications}
    assert {"joystick", "robot", "space_gateway", "ground_gateway"} <= apids.keys()
    assert min(apids.values()) >= 0x120
