"""The telecommands of a dictionary in XTCE. Telemetry is read by others: `tests/interop`."""

from xml.etree import ElementTree

from pus_ends import oven

from telepresence.tmtc.pus.packets import Telecommand, pack_packet
from telepresence.tmtc.pus.values import pack_values
from telepresence.tmtc.pus.xtce import NAMESPACE, dictionary_xtce

ROOT = ElementTree.fromstring(dictionary_xtce(oven()).encode())
METAS = {one.get("name"): one for one in ROOT.iterfind(".//{*}MetaCommand")}
INITIAL = {"ACKNOWLEDGE": 15, "SOURCE": 3}


def type_of(argument):
    types = ROOT.find(".//{*}ArgumentTypeSet")
    (found,) = types.findall(f"./*[@name='{argument.get('argumentTypeRef')}']")
    return found


def encoded(name, arguments):
    """The telecommand's bits by its containers alone; arguments: raw numbers."""
    meta, base = METAS[name], METAS["PusTelecommand"]
    assigned = {
        one.get("argumentName"): int(one.get("argumentValue"))
        for one in meta.iterfind(".//{*}ArgumentAssignment")
    }
    values = {**INITIAL, **assigned, **arguments}
    listed = {
        one.get("name"): one
        for one in [*base.iter(f"{{{NAMESPACE}}}Argument"), *meta.iter(f"{{{NAMESPACE}}}Argument")]
    }
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
    for name, service, subtype, data, arguments in (
        ("oven_off", 8, 1, b"\2", {}),
        ("oven_heat", 8, 1, b"\1" + pack_values(table.named(["target"]), [40]), {"target": 80}),
        ("oven_ping", 17, 1, b"", {}),
        ("oven_report", 3, 27, b"\1\2", {"which": 2}),
        ("oven_limits_off", 12, 2, b"\1\1", {"which": 1}),
        ("oven_get", 20, 1, b"\1\5", {"which": 5}),
        ("oven_set_target", 20, 3, b"\1\3\0\x50", {"target": 80}),
    ):
        octets = pack_packet(
            Telecommand(apid=0x200, count=0, service=service, subtype=subtype, data=data, source=3)
        )
        # Without sequence count, length and check, which the ground system fills in.
        found = encoded(name, arguments)
        assert found[:4] + found[6:] == octets[:4] + octets[6:-2], name


def test_arguments_have_ranges_units_and_names():
    heat = type_of(METAS["oven_heat"].find(".//{*}Argument"))
    assert heat.find(".//{*}ValidRange").attrib == {"maxInclusive": "250.0"}
    assert [one.get("coefficient") for one in heat.iterfind(".//{*}Term")] == ["0", "2.0"]
    which = type_of(METAS["oven_report"].find(".//{*}Argument"))
    assert [
        (one.get("value"), one.get("label")) for one in which.iterfind(".//{*}Enumeration")
    ] == [
        ("1", "state"),
        ("2", "light"),
    ]
    assert "oven_set_lit" not in METAS
    assert "oven_actions_on" in METAS


def test_every_field_of_telemetry_is_defined_with_its_type():
    parameters = {one.get("name"): one for one in ROOT.iterfind(".//{*}ParameterSet/{*}Parameter")}
    types = {one.get("name") for one in ROOT.find(".//{*}ParameterTypeSet")}
    assert {one.get("parameterTypeRef") for one in parameters.values()} == types
    fields = {one.get("parameterRef") for one in ROOT.iterfind(".//{*}ParameterRefEntry")}
    assert fields == set(parameters)
    assert parameters["TIME"].get("shortDescription") == "when it was reported"
