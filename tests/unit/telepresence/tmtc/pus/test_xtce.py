"""A dictionary as XTCE: octets of telecommands, and space_packet_parser of LASP reads telemetry."""

import re
from math import tau
from xml.etree import ElementTree

import pytest
from pus_ends import MS, Ends, command, oven, oven_table
from xtce_decoder import decoded

from telepresence.haptics.mediated.wall import Wall, WallMessage, pack_wall
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary, dictionary_from_table
from telepresence.tmtc.pus.packets import pack_packet
from telepresence.tmtc.pus.values import pack_values
from telepresence.tmtc.pus.xtce import NAMESPACE, dictionary_xtce


def parsed(dictionary, *end):
    return ElementTree.fromstring(dictionary_xtce(dictionary, *end).encode())


def named(elements):
    return {element.get("name"): element for element in elements}


ROOT = parsed(oven())
METAS = named(ROOT.iterfind(".//{*}MetaCommand"))
INITIAL = {"ACKNOWLEDGE": 15, "SOURCE": 3}
#: Name, service, subtype, data, and the arguments as raw numbers.
COMMANDS = (
    ("oven_heat", 8, 1, b"\1", {"target": 80}),
    ("oven_off", 8, 1, b"\2", {}),
    ("oven_report", 3, 27, b"\1\2", {"which": 2}),
    # A function is called "off", too, and goes before the switch.
    ("oven_on", 3, 5, b"\1\1", {"which": 1}),
    ("oven_events_on", 5, 5, b"\1\2", {"which": 2}),
    ("oven_events_off", 5, 6, b"\1\1", {"which": 1}),
    ("oven_limits_on", 12, 1, b"\1\1", {"which": 1}),
    ("oven_limits_off", 12, 2, b"\1\1", {"which": 1}),
    ("oven_actions_on", 19, 4, b"\1\1", {"which": 1}),
    ("oven_actions_off", 19, 5, b"\1\1", {"which": 1}),
    ("oven_get", 20, 1, b"\1\5", {"which": 5}),
    ("oven_ping", 17, 1, b"", {}),
    ("oven_set_target", 20, 3, b"\1\3\0\x50", {"target": 80}),
)


def type_of(argument):
    types = ROOT.find(".//{*}ArgumentTypeSet")
    (found,) = types.findall(f"./*[@name='{argument.get('argumentTypeRef')}']")
    return found


def labels(kind):
    return [(one.get("value"), one.get("label")) for one in kind.iter() if one.get("label")]


def encoded(name, arguments):
    """The telecommand's bits by its containers alone; arguments: raw numbers."""
    meta, base = METAS[name], METAS["PusTelecommand"]
    assigned = {
        one.get("argumentName"): int(one.get("argumentValue"))
        for one in meta.iterfind(".//{*}ArgumentAssignment")
    }
    values = {**INITIAL, **assigned, **arguments}
    arguments_of = f"{{{NAMESPACE}}}Argument"
    listed = named([*base.iter(arguments_of), *meta.iter(arguments_of)])
    bits = ""
    for entry in [*base.find(".//{*}EntryList"), *meta.find(".//{*}EntryList")]:
        if entry.get("binaryValue") is not None:
            size, value = int(entry.get("sizeInBits")), int(entry.get("binaryValue"), 16)
        else:
            argument = listed[entry.get("argumentRef")]
            encoding = next(one for one in type_of(argument) if one.tag.endswith("Encoding"))
            size, value = int(encoding.get("sizeInBits")), values[argument.get("name")]
        bits += f"{value:0{size}b}"
    return int(bits, 2).to_bytes(len(bits) // 8, "big")


def test_telecommands_have_the_octets_that_the_application_reads():
    table = oven().application("oven")
    assert [name for name in METAS if name.startswith("oven_")] == [name for name, *_ in COMMANDS]
    for name, service, subtype, data, arguments in COMMANDS:
        if name == "oven_heat":
            data += pack_values(table.named(["target"]), [40])
        octets = pack_packet(command(service, subtype, data, count=0, source=3))
        # Without sequence count, length and check, which the ground system fills in.
        found = encoded(name, arguments)
        assert found[:4] + found[6:] == octets[:4] + octets[6:-2], name
        assert len(found) == len(octets) - 2


@pytest.mark.parametrize(
    ("tag", "name", "good", "bad", "window"),
    [
        ("AcceptedVerifier", "Accepted", {1}, {2, 10}, "PT35S"),
        ("ExecutionVerifier", "Started", {3}, {4}, "PT35S"),
        ("CompleteVerifier", "Completed", {7}, {2, 4, 8, 10}, "PT45S"),
    ],
)
def test_a_stage_is_verified_by_its_reports_about_this_telecommand(tag, name, good, bad, window):
    """ECSS-E-ST-70-41C clause 8.1.2. Repetitions go on for 30 s."""
    (verifier,) = METAS["PusTelecommand"].iterfind(f".//{{*}}{tag}")
    assert verifier.get("name") == name
    script = verifier.find(".//{*}AlgorithmText").text
    success, _, failure = script.partition("return true")
    assert {int(one) for one in re.findall(r"subtype.value == (\d+)", success)} == good
    assert {int(one) for one in re.findall(r"subtype.value == (\d+)", failure)} == bad
    assert "(+destination.value & 255) == +sentSource.value" in success
    inputs = {
        one.get("inputName"): one.get("parameterRef")
        for one in verifier.iterfind(".//{*}InputParameterInstanceRef")
    }
    assert inputs == {
        "sentApid": "/yamcs/cmd/arg/APID",
        "sentCount": "/yamcs/cmdHist/ccsds-seqcount",
        "sentSource": "/yamcs/cmd/arg/SOURCE",
        "apid": "REQUEST_APID",
        "count": "REQUEST_COUNT",
        "destination": "DESTINATION",
        "subtype": "SUBTYPE",
        "reason": "REASON",
    }
    needed = {one.text: one.get("name") for one in verifier.iterfind(".//{*}AncillaryData")}
    # Only failures have a reason.
    assert needed == dict.fromkeys(inputs.keys() - {"reason"}, "Yamcs:AlgorithmMandatoryInput")
    assert verifier.find(".//{*}CheckWindow").attrib == {
        "timeToStopChecking": window,
        "timeWindowIsRelativeTo": "commandRelease",
    }


def test_types_have_what_others_show_and_check():
    table = oven_table()
    table["oven"]["parameter"]["note"] = {"number": 6, "type": "text", "size": 9, "unit": "x"}
    table["oven"]["parameter"]["depth"] |= {"low": -3, "high": 4, "unit": "mm", "writable": True}
    table["oven"]["parameter"]["target"]["text"] = "what it heats to"
    root = parsed(dictionary_from_table(table))

    def kind(name):
        (found,) = root.iterfind(f".//*[@name='{name}_TYPE']")
        return found

    depth, asked = kind("oven_depth"), kind("oven_set_depth_depth")
    assert depth.find("./{*}UnitSet/{*}Unit").text == "mm"
    assert (depth.get("signed"), kind("COUNTER").get("signed")) == ("true", "false")
    assert depth.find(".//{*}WarningRange").attrib == {
        "minInclusive": "-3.0",
        "maxInclusive": "4.0",
    }
    assert asked.find(".//{*}ValidRange").attrib == {"minInclusive": "-3", "maxInclusive": "4"}
    encoding = depth.find("./{*}IntegerDataEncoding")
    assert encoding.attrib == {"sizeInBits": "32", "encoding": "twosComplement"}
    target = kind("oven_target")
    assert target.get("signed") is None and target.tag.endswith("FloatParameterType")
    # Of telemetry: from the integer on the wire to the value.
    terms = [(one.get("coefficient"), one.get("exponent")) for one in target.iterfind(".//{*}Term")]
    assert terms == [("0", "0"), ("0.5", "1")]
    assert target.find(".//{*}WarningRange").attrib == {"maxInclusive": "250.0"}
    note = kind("oven_note")
    assert note.find(".//{*}FixedValue").text == "80"
    assert kind("oven_lit").attrib.items() >= {("oneStringValue", "true")}
    assert kind("oven_temperature").get("sizeInBits") == "32"
    assert labels(kind("oven_door")) == [("0", "open"), ("1", "closed")]
    (meta,) = root.iterfind(".//{*}MetaCommand[@name='oven_set_target']")
    assert meta.get("shortDescription") == "what it heats to"


def recorded():
    """Ten seconds of telemetry of the oven: housekeeping, events, verification of telecommands."""
    ends = Ends()
    ends.oven.handle_values({"temperature": 21.5, "door": "closed", "lit": True}, 0)
    ends.user.set_parameters("oven", {"target": 99.5}, now_ns=0)
    ends.run(2500 * MS)
    for _ in range(2):
        ends.oven.handle_values({"temperature": 230.0}, ends.now_ns)
    ends.refusal = "no heat today"
    ends.user.call("oven", "heat", [20.0], now_ns=ends.now_ns)
    ends.user.request_housekeeping("oven", "light", now_ns=ends.now_ns)
    ends.user.request_parameters("oven", ["target"], now_ns=ends.now_ns)
    ends.user.ping("oven", now_ns=ends.now_ns)
    ends.run(4500 * MS)
    return b"".join(ends.telemetry)


def test_it_reads_every_kind_of_report(tmp_path):
    packets = decoded(oven(), recorded(), tmp_path)
    states = [one for one in packets if {"oven_temperature", "STRUCTURE"} <= one.keys()]
    # As soon as the values are known, then at the interval.
    heats = enumerate((21.5, 21.5, 21.5, 230.0, 230.0))
    assert [(p["TIME"], p["oven_temperature"], p["oven_door"]) for p in states] == [
        (at, heat, "closed") for at, heat in heats
    ]
    (event,) = [packet for packet in packets if "EVENT" in packet]
    assert (event["SUBTYPE"], event["EVENT"], event["oven_temperature"]) == (4, 1, 230.0)
    (failure,) = [packet for packet in packets if "REASON" in packet]
    assert (failure["REASON"], failure["FAILURE"]) == ("no heat today", 4)
    (light,) = [packet for packet in packets if "oven_lit" in packet]
    assert light["oven_lit"]
    subtypes = [packet["SUBTYPE"] for packet in packets if packet["SERVICE"] == 1]
    assert sorted(subtypes) == [1, 1, 1, 1, 1, 3, 3, 3, 3, 3, 7, 7, 7, 7, 8]
    assert {(p["SERVICE"], p["SUBTYPE"]) for p in packets} >= {(17, 2), (20, 2)}


def test_the_xtce_of_the_built_in_dictionary_is_valid(tmp_path):
    """By the schema of the OMG, which comes with space_packet_parser."""
    validation = pytest.importorskip("space_packet_parser.xtce.validation")
    document = tmp_path / "kontur.xml"
    document.write_text(dictionary_xtce(built_in_dictionary()), encoding="utf-8")
    result = validation.validate_xtce(document, level="all")
    assert result.valid, str(result)


def test_it_knows_the_packets_with_walls(tmp_path):
    message = WallMessage(3035, Wall(tau / 8, 0.06, 1500.0))
    (wall,) = decoded(built_in_dictionary(), pack_wall(message, 7), tmp_path)
    names = ("ANGLE", "STAMP_MS", "DISTANCE", "STIFFNESS")
    assert [wall[f"WALL_{name}"] for name in names] == [8192, 3035, 3000, 1500]
